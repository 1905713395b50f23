// SPDX-FileCopyrightText: 2026 the DyKnow developers
// SPDX-License-Identifier: BSD-3-Clause

namespace dyknow_benchmark
{
void runNode(int argc, char** argv);
}

int main(int argc, char** argv)
{
  dyknow_benchmark::runNode(argc, argv);
}
