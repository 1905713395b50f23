// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file The nodelet manager in C++ whose nodelets have live ports: the stock one, with our library linked
/// first.
#include <nodelet/loader.h>
#include <ros/ros.h>

#include "dyknow_roscpp/process_services.h"
#include "dyknow_roscpp/self_check.h"

int main(int argc, char** argv)
{
  ros::init(argc, argv, "manager");
  const ros::NodeHandle node;
  if (dyknow::areHooksReached())  // otherwise the log names the fault, and the nodelets run all the same
  {
    dyknow::offerProcessServices();  // first: clients of the loader's services know its kind
  }
  const nodelet::Loader loader;
  ros::spin();
  return 0;
}
