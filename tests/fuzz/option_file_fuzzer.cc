// A project file as a command reads it: values of every kind, a bound, an enumeration.

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <optional>
#include <string>
#include <vector>

#include "plugin/cli/options.h"
#include "sfm_split/base/error.h"
#include "tests/fuzz/fuzz_seeds.h"
#include "tests/fuzz/scratch_path.h"

namespace {

constexpr int32_t kMaxCount = 100;

struct Group {
  int32_t count = 3;
  std::optional<double> ratio;
  s2gs::OptionCheck Check() const {
    if (count < 0 || count > kMaxCount) return s2gs::OptionFault{"count", std::to_string(count), "0 to 100"};
    return std::nullopt;
  }
};

// One command's options and what they set.
struct Command {
  enum class Colour { kRed, kGreen };
  bool flag = false;
  int64_t large = 0;
  uint32_t small = 0;
  uint64_t huge = 0;
  float single = 0;
  double number = 0;
  std::string text;
  std::filesystem::path path;
  std::vector<double> list;
  Colour colour = Colour::kRed;
  Group group;
  s2gs::Options options{"command", "Does nothing.", "--text a"};

  Command() {
    options.Add("flag", &flag, "a flag");
    options.Add("large", &large, "a number");
    options.Add("small", &small, "a number");
    options.Add("huge", &huge, "a number");
    options.Add("single", &single, "a number");
    options.Add("number", &number, "a number");
    options.Add("text", &text, "a text");
    options.Add("path", &path, "a path");
    options.Add("list", &list, "a list");
    options.AddEnum("colour", &colour, {{"red", Colour::kRed}, {"green", Colour::kGreen}}, "a colour");
    auto in_group = options.Group("Group", &group, "a group");
    in_group.Add("count", &Group::count, "a bounded number");
    in_group.Add("ratio", &Group::ratio, "a number that may be absent");
  }
};

bool AreFinite(const Command& command) {
  for (const double value : command.list) {
    if (!std::isfinite(value)) return false;
  }
  return std::isfinite(command.single) && std::isfinite(command.number) &&
         std::isfinite(command.group.ratio.value_or(0));
}

}  // namespace

std::vector<std::string> FuzzSeeds() {
  return {
      "flag = 1\nlarge=-5\nsmall = 7\nhuge=18446744073709551615\nsingle = 1e-3\nnumber=-2.5\ntext = \"a b\"\n"
      "path=/x/y\nlist = 1,2.5,-3\ncolour = green\nrandom_seed = 4\nlog_level=debug\n[Group]\ncount = "
      "9\nratio=.5\n",
      "# nothing\n; either\n", "[Group]\ncount = 101\n"};
}

// What was accepted is within its bounds, and what it is shown as sets the same again.
extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static const std::filesystem::path path = s2gs::ScratchPath("options.ini");
  std::ofstream(path, std::ios::binary)
      .write(reinterpret_cast<const char*>(data), static_cast<std::streamsize>(size));
  try {
    Command command;
    command.options.Parse({"--project_path", path.string()});
    if (command.group.count < 0 || command.group.count > kMaxCount || !AreFinite(command)) std::abort();
    std::vector<std::string> arguments;
    for (const auto& [name, value] : command.options.Values()) {
      if (name == "project_path" || value.empty()) continue;
      arguments.insert(arguments.end(), {"--" + name, value});
    }
    Command again;
    again.options.Parse(arguments);
    if (again.options.Values() != command.options.Values()) {
      auto mine = again.options.Values();
      auto first = command.options.Values();
      mine.erase("project_path");
      first.erase("project_path");
      if (mine != first) std::abort();
    }
  } catch (const s2gs::UserError&) {
  } catch (const s2gs::CommandLineError&) {
  }
  return 0;
}
