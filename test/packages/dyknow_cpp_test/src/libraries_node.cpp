// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

#include "libraries.h"

int main(int argc, char** argv)
{
  ros::init(argc, argv, "libraries");
  const dyknow_cpp_test::Libraries libraries(ros::NodeHandle(), ros::NodeHandle("~"));
  ros::spin();
  return 0;
}
