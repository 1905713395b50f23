// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file The nodelet manager in C++ whose nodelets have live ports: the stock one, with our library linked
/// first.
#include <nodelet/loader.h>
#include <ros/ros.h>

int main(int argc, char** argv)
{
  ros::init(argc, argv, "manager");
  const ros::NodeHandle node;
  const nodelet::Loader loader;
  ros::spin();
  return 0;
}
