#pragma once

#include <string>
#include <vector>

/// Valid inputs to start from, made by the project's own writers. Every fuzz target defines it;
/// fuzz_seeds.cc writes them into the corpus folder given on the command line.
std::vector<std::string> FuzzSeeds();
