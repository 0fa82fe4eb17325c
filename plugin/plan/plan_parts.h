#pragma once

#include <set>
#include <string>
#include <utility>
#include <vector>

namespace s2gs {

/// A part of a scan that some scenes do not need.
struct PlanPart {
  std::string name;   ///< for --force and plan.json.
  std::string what;   ///< in words.
  std::string stage;  ///< that it belongs to (StandardStages).
  std::string after;  ///< the stage after which the decision can be taken; empty: from the photos alone.
  /// The command that can be told not to leave it out, and with which options; empty where nothing would be
  /// there to run.
  std::string command;
  std::vector<std::pair<std::string, std::string>> forced_by;
  std::string never_forced;  ///< why nothing can force it; empty where it can be.

  bool CanBeForced() const { return !command.empty(); }
};

/// In the order of the stages.
const std::vector<PlanPart>& PlanParts();

/// The parts that are meant by what stands behind --force: names of parts, names of stages (all parts of it
/// that can be forced), 1 (training on poses that are doubtful) and 0 (nothing). Throws CommandLineError for
/// other names, and for parts that cannot be forced.
std::set<std::string> ForcedParts(const std::vector<std::string>& names);

/// The arguments that make a command run the parts that are forced.
std::vector<std::string> ForcedArguments(const std::string& command, const std::set<std::string>& parts);

}  // namespace s2gs
