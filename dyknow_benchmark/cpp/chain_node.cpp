// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

// One part of the chain as a node: benchmark_chain source | hop
#include "chain.h"

template <class Part>
void run()
{
  Part part{ros::NodeHandle(), ros::NodeHandle("~")};
  ros::spin();
}

int main(int argc, char** argv)
{
  ros::init(argc, argv, "benchmark_chain", ros::init_options::AnonymousName);
  const bool is_source = argc == 2 && std::string(argv[1]) == "source";
  (is_source ? run<dyknow_benchmark::Source> : run<dyknow_benchmark::Hop>)();
}
