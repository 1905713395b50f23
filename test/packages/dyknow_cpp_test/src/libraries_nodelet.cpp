// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include <nodelet/nodelet.h>

#include <memory>
#include <pluginlib/class_list_macros.hpp>

#include "libraries.h"

namespace dyknow_cpp_test
{

class LibrariesNodelet : public nodelet::Nodelet
{
  void onInit() override
  {
    libraries_ = std::make_unique<Libraries>(getNodeHandle(), getPrivateNodeHandle());
  }

  std::unique_ptr<Libraries> libraries_;
};

}  // namespace dyknow_cpp_test

PLUGINLIB_EXPORT_CLASS(dyknow_cpp_test::LibrariesNodelet, nodelet::Nodelet)
