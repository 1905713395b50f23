// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

// One part of the chain as a node: benchmark_chain source | hop
#include "chain.h"

#include <iostream>
#include <string>

int main(int argc, char** argv)
{
  ros::init(argc, argv, "benchmark_chain", ros::init_options::AnonymousName);
  const std::string part = argc == 2 ? argv[1] : "";
  if (part != "source" && part != "hop")
  {
    std::cerr << "usage: benchmark_chain source|hop" << std::endl;
    return 2;
  }
  ros::NodeHandle nh;
  ros::NodeHandle private_nh("~");
  if (part == "source")
  {
    dyknow_benchmark::Source source(nh, private_nh);
    ros::spin();
  }
  else
  {
    dyknow_benchmark::Hop hop(nh, private_nh);
    ros::spin();
  }
  return 0;
}
