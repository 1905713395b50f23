// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

/// @file The nodelet manager in C++ whose nodelets have live ports: the stock one, with our library linked
/// first.
#include <nodelet/loader.h>
#include <ros/ros.h>

#include <iostream>
#include <string>

namespace
{
const char* const USAGE = R"(usage: rosrun dyknow cpp_nodelet_manager [__name:=NAME] [FROM:=TO ...] [_PARAM:=VALUE ...]

A nodelet manager for nodelets in C++, whose ports DyKnow re-wires while they run. Load nodelets with
  rosrun nodelet nodelet load PACKAGE/TYPE NAME
Private parameters:
  _num_worker_threads:=N   threads that run the callbacks (default: one for each core)
  _stuck_after:=SECONDS    report a callback that has not returned by then
  _rewirable:=false        refuse to connect ports elsewhere
)";
}  // namespace

int main(int argc, char** argv)
{
  for (int each = 1; each < argc; ++each)
  {
    const std::string word = argv[each];
    if (word == "-h" || word == "--help")
    {
      std::cout << USAGE;
      return 0;
    }
  }
  ros::init(argc, argv, "manager");
  const ros::NodeHandle node;
  const nodelet::Loader loader;
  ros::spin();
  return 0;
}
