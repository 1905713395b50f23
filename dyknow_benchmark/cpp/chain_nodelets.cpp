// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

// The chain's parts as nodelets of the stock C++ nodelet manager.
#include "chain.h"

#include <nodelet/nodelet.h>
#include <pluginlib/class_list_macros.hpp>

#include <memory>

namespace dyknow_benchmark
{

template <template <class> class Kind>
class ChainNodelet : public nodelet::Nodelet
{
  void onInit() override
  {
    part_ = makePart<Kind>(getNodeHandle(), getPrivateNodeHandle());
  }

  std::unique_ptr<Part> part_;
};

using SourceNodelet = ChainNodelet<Source>;
using HopNodelet = ChainNodelet<Hop>;

}  // namespace dyknow_benchmark

PLUGINLIB_EXPORT_CLASS(dyknow_benchmark::SourceNodelet, nodelet::Nodelet)
PLUGINLIB_EXPORT_CLASS(dyknow_benchmark::HopNodelet, nodelet::Nodelet)
