// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

// One part of the chain as a node: benchmark_chain source | hop
#include "chain.h"

using namespace dyknow_benchmark;

int main(int argc, char** argv)
{
  ros::init(argc, argv, "benchmark_chain", ros::init_options::AnonymousName);
  const bool is_source = argc == 2 && std::string(argv[1]) == "source";
  const auto part = (is_source ? makePart<Source> : makePart<Hop>)(ros::NodeHandle(), ros::NodeHandle("~"));
  ros::spin();
}
