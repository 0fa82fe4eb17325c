#include "plugin/cli/options.h"

#include <algorithm>
#include <set>
#include <utility>

#include "plugin/cli/help_table.h"
#include "plugin/cli/project_file.h"
#include "plugin/cli/suggest.h"

namespace s2gs {
namespace {

constexpr char kProjectPath[] = "project_path";
constexpr char kRandomSeed[] = "random_seed";
constexpr char kLogLevel[] = "log_level";
constexpr size_t kNumStandardOptions = 3;
constexpr char kOptionsTitle[] = "Options (booleans are 0 or 1):\n";

std::string GroupOf(const std::string& name) {
  const size_t point = name.rfind('.');
  return point == std::string::npos ? std::string() : name.substr(0, point);
}

std::string FieldOf(const std::string& name) {
  const size_t point = name.rfind('.');
  return point == std::string::npos ? name : name.substr(point + 1);
}

std::string Join(const std::vector<std::string>& words, const std::string& between,
                 const std::string& before) {
  std::string text;
  for (const std::string& word : words) {
    if (!text.empty()) text += between;
    text += before;
    text += word;
  }
  return text;
}

std::string From(const std::string& given_by) { return given_by.empty() ? "" : given_by + ": "; }

// Word processors and web pages turn "--" into one long dash.
std::string WithPlainDashes(const std::string& argument) {
  for (const char* dash : {"\xE2\x80\x93", "\xE2\x80\x94"}) {
    if (argument.compare(0, 3, dash) == 0) return "--" + argument.substr(3);
  }
  return argument;
}

}  // namespace

Options::Options(std::string command, std::string summary, std::string example)
    : command_(std::move(command)), summary_(std::move(summary)), example_(std::move(example)) {
  Add(kProjectPath, &project_path_,
      "a file of options: `name = value` lines, then `[Group]` lines with those of a group; the command line "
      "wins");
  Add(kRandomSeed, &random_seed_, "where random numbers start");
  const EnumNames<LogLevel> levels = {
      {"debug", LogLevel::kDebug}, {"info", LogLevel::kInfo}, {"warning", LogLevel::kWarning},
      {"error", LogLevel::kError}, {"0", LogLevel::kDebug},   {"1", LogLevel::kInfo},
      {"2", LogLevel::kWarning},   {"3", LogLevel::kError},
  };
  AddEnum(kLogLevel, &log_level_, levels, "the least severe messages shown");
  S2GS_INVARIANT(options_.size() == kNumStandardOptions);
}

Option& Options::AddOption(const std::string& name, const std::string& kind,
                           std::function<void(const std::string&)> set, std::function<std::string()> get,
                           const std::string& help) {
  S2GS_INVARIANT(Find(name) == nullptr);
  auto option = std::make_unique<Option>();
  option->name_ = name;
  option->kind_ = kind;
  option->help_ = help;
  option->set_ = std::move(set);
  option->get_ = std::move(get);
  option->default_ = option->get_();
  option->group_ = section_;
  for (const GroupInfo& group : groups_) {
    if (group.name == GroupOf(name)) option->group_ = group.name;
  }
  options_.push_back(std::move(option));
  return *options_.back();
}

void Options::AddGroup(const std::string& name, const std::string& about) {
  S2GS_INVARIANT(!name.empty() && !about.empty());
  for (const GroupInfo& group : groups_) S2GS_INVARIANT(group.name != name);
  groups_.push_back({name, about});
}

void Options::Section(const std::string& name, const std::string& about, const std::function<void()>& add) {
  S2GS_INVARIANT(section_.empty());
  AddGroup(name, about);
  section_ = name;
  add();
  section_.clear();
}

Option* Options::Find(const std::string& name) const {
  for (const auto& option : options_) {
    if (option->name_ == name) return option.get();
  }
  return nullptr;
}

void Options::Parse(const std::vector<std::string>& arguments) {
  for (size_t i = 0; i < arguments.size(); ++i) {
    if (arguments[i] != "-h" && arguments[i] != "--help") continue;
    const bool has_name = i + 1 < arguments.size() && arguments[i + 1].compare(0, 1, "-") != 0;
    if (has_name) throw HelpRequested(GroupHelp(arguments[i + 1]));
    throw HelpRequested(arguments[i] == "-h" ? Help() : FullHelp());
  }
  const std::vector<Given> given = ReadArguments(arguments);
  for (const auto& [option, value] : given) {
    if (option->name_ == kProjectPath) Set(*option, value, "");
  }
  if (!project_path_.empty()) ApplyProjectFile();
  for (const auto& [option, value] : given) Set(*option, value, "");
  CheckRequired();
  CheckBounds();
}

std::vector<Options::Given> Options::ReadArguments(const std::vector<std::string>& arguments) const {
  std::vector<Given> given;
  for (size_t i = 0; i < arguments.size(); ++i) {
    const std::string& argument = arguments[i];
    if (argument.compare(0, 2, "--") != 0 || argument.size() == 2) FailNoOption(argument, given);
    const size_t equals = argument.find('=');
    const std::string shown = argument.substr(0, equals);
    Option* option = Find(shown.substr(2));
    if (option == nullptr) FailUnknown(shown.substr(2), shown, "");
    const bool is_given = std::any_of(given.begin(), given.end(),
                                      [&](const Given& earlier) { return earlier.first == option; });
    if (is_given) throw CommandLineError(shown + " is given twice");
    if (equals != std::string::npos) {
      given.emplace_back(option, argument.substr(equals + 1));
    } else if (i + 1 < arguments.size() && arguments[i + 1].compare(0, 2, "--") != 0) {
      given.emplace_back(option, arguments[++i]);
    } else {
      FailNoValue(*option);
    }
  }
  return given;
}

void Options::FailNoOption(const std::string& argument, const std::vector<Given>& given) const {
  const std::string plain = WithPlainDashes(argument);
  const size_t dashes = std::min(plain.find_first_not_of('-'), plain.size());
  const std::string name = plain.substr(dashes);
  if (dashes > 0 && Find(name) != nullptr) {
    throw CommandLineError("options begin with two plain dashes: --" + name + ", not " + argument);
  }
  if (dashes > 0) FailUnknown(name, argument, "");
  const std::string after =
      given.empty() ? "" : " after --" + given.back().first->name_ + " " + given.back().second;
  throw CommandLineError("\"" + argument + "\"" + after +
                         " belongs to no option. Values with spaces need quotes");
}

void Options::FailNoValue(const Option& option) {
  const std::string kind = option.kind_ == "0|1" ? "0 or 1" : option.kind_;
  throw CommandLineError("--" + option.name_ + " needs a value: --" + option.name_ + " " + kind);
}

void Options::Set(Option& option, const std::string& value, const std::string& given_by) {
  try {
    option.set_(value);
  } catch (const BadValue& fault) {
    const std::string shown = given_by.empty() ? "--" + option.name_ : given_by + ": " + option.name_;
    throw CommandLineError(shown + ": \"" + value + "\" " + fault.what());
  }
  option.given_by_ = given_by.empty() ? "the command line" : given_by;
}

void Options::ApplyProjectFile() {
  std::map<std::string, int> line_of;
  for (const ProjectFileEntry& entry : ReadProjectFile(project_path_)) {
    const std::string place = project_path_.string() + ", line " + std::to_string(entry.line);
    Option* option = Find(entry.name);
    if (option == nullptr) FailUnknown(entry.name, entry.name, place);
    if (entry.name == kProjectPath) {
      throw CommandLineError(place + ": a project file cannot name another one");
    }
    const auto [first, is_new] = line_of.emplace(entry.name, entry.line);
    if (!is_new) {
      throw CommandLineError(place + ": " + entry.name + " is already given in line " +
                             std::to_string(first->second));
    }
    // COLMAP writes `name=` for what is not set.
    if (!entry.value.empty()) Set(*option, entry.value, place);
  }
}

void Options::CheckRequired() const {
  std::vector<std::string> missing;
  for (const auto& option : options_) {
    if (option->is_required_ && option->given_by_.empty())
      missing.push_back(option->name_ + " " + option->kind_);
  }
  if (missing.empty()) return;
  throw CommandLineError("missing: " + Join(missing, ", ", "--") + "\nExample:\n" + Example());
}

void Options::CheckBounds() const {
  for (const auto& [group, check] : checks_) {
    const OptionCheck fault = check();
    if (!fault.has_value()) continue;
    const std::string name = group.empty() ? fault->field : group + "." + fault->field;
    const Option* option = Find(name);
    const bool is_from_file =
        option != nullptr && !option->given_by_.empty() && option->given_by_ != "the command line";
    throw CommandLineError(From(is_from_file ? option->given_by_ : "") + name + " = " + fault->value +
                           " violates " + fault->bound);
  }
}

void Options::FailUnknown(const std::string& name, const std::string& shown,
                          const std::string& given_by) const {
  const std::string prefix = given_by.empty() ? "--" : "";
  std::string message = From(given_by) + "unknown option " + shown + ". ";
  std::vector<std::string> names;
  std::vector<std::string> in_groups;
  std::set<std::string> groups;
  for (const auto& option : options_) {
    names.push_back(option->name_);
    if (FieldOf(option->name_) == FieldOf(name)) in_groups.push_back(option->name_);
    if (!GroupOf(option->name_).empty()) groups.insert(GroupOf(option->name_));
  }
  std::string with_underscores = name;
  std::replace(with_underscores.begin(), with_underscores.end(), '-', '_');
  if (Find(with_underscores) != nullptr) {
    throw CommandLineError(message + "Names have '_', not '-': " + prefix + with_underscores);
  }
  if (in_groups.size() == 1) {
    const std::string group = GroupOf(in_groups[0]);
    throw CommandLineError(
        message + FieldOf(name) +
        (group.empty() ? " belongs to no group: " : " belongs to the group " + group + ": ") + prefix +
        in_groups[0]);
  }
  // A misspelt group with the right field is among these: the distances are those of full names.
  std::vector<std::string> nearest = in_groups.empty() ? NearestWords(name, names) : in_groups;
  if (nearest.empty()) {
    // The group may have been left out and the field misspelt.
    for (const std::string& candidate : names) {
      if (!NearestWords(FieldOf(name), {FieldOf(candidate)}).empty()) nearest.push_back(candidate);
    }
    if (nearest.size() > 3) nearest.clear();
  }
  if (!nearest.empty())
    throw CommandLineError(message + "Did you mean " + Join(nearest, " or ", prefix) + "?");
  const std::string group = GroupOf(name);
  if (!group.empty() && groups.count(group) == 0 && !groups.empty()) {
    message +=
        "There is no group " + group + " here, only " + Join({groups.begin(), groups.end()}, ", ", "") + ". ";
  }
  message.resize(message.find_last_not_of(". ") + 1);
  throw CommandLineError(message + ".");
}

std::string Options::Example() const { return "  s2gs " + command_ + " " + example_; }

std::string Options::Usage() const {
  std::string usage = "s2gs " + command_;
  for (const auto& option : options_) {
    if (option->is_required_) usage += " --" + option->name_ + " " + option->kind_;
  }
  return usage + " [options]";
}

std::vector<const Option*> Options::OptionsOf(const std::string& group) const {
  std::vector<const Option*> found;
  for (size_t i = kNumStandardOptions; i < options_.size(); ++i) {
    if (options_[i]->group_ == group) found.push_back(options_[i].get());
  }
  return found;
}

HelpRow Options::RowOf(const Option& option) {
  std::string value = option.is_required_ ? "required" : option.default_.empty() ? "-" : option.default_;
  std::string meaning = option.help_;
  if (!option.bound_.empty()) meaning += " (" + option.bound_ + ")";
  return {"--" + option.name_ + " " + option.kind_, std::move(value), option.unit_, std::move(meaning)};
}

std::string Options::HelpHead() const {
  return Join(Wrapped("s2gs " + command_ + ": " + summary_, kHelpWidth), "\n", "") + "\n\nUsage:\n  " +
         Usage() + "\n\nExample:\n" + Example() + "\n\n" + kOptionsTitle;
}

HelpTable Options::OwnTable() const {
  HelpTable table;
  const std::vector<const Option*> own = OptionsOf("");
  for (const Option* option : own) table.Add(RowOf(*option));
  if (!own.empty()) table.BeginPart("");
  for (size_t i = 0; i < kNumStandardOptions; ++i) table.Add(RowOf(*options_[i]));
  if (groups_.empty()) {
    table.Add({"-h, --help", "", "", "print this and exit"});
  } else {
    table.Add({"-h [GROUP]", "", "", "print this, or the options of a group, and exit"});
    table.Add({"--help", "", "", "print all options, those of all groups too, and exit"});
  }
  return table;
}

std::string Options::Help() const {
  std::string text = HelpHead() + OwnTable().Text();
  if (groups_.empty()) return text;
  size_t name_width = 0;
  size_t count_width = 0;
  for (const GroupInfo& group : groups_) {
    name_width = std::max(name_width, group.name.size());
    count_width = std::max(count_width, std::to_string(OptionsOf(group.name).size()).size());
  }
  text +=
      "\nGroups of more options (`s2gs " + command_ + " -h " + groups_[0].name + "` lists those of one):\n";
  for (const GroupInfo& group : groups_) {
    const std::string count = std::to_string(OptionsOf(group.name).size());
    text += "  " + group.name +
            std::string(name_width - group.name.size() + 2 + count_width - count.size(), ' ') + count + "  " +
            group.about + "\n";
  }
  return text;
}

std::string Options::FullHelp() const {
  HelpTable table = OwnTable();
  for (const GroupInfo& group : groups_) {
    table.BeginPart(group.name + ": " + group.about);
    for (const Option* option : OptionsOf(group.name)) table.Add(RowOf(*option));
  }
  return HelpHead() + table.Text();
}

std::string Options::GroupHelp(const std::string& name) const {
  std::vector<std::string> names;
  for (const GroupInfo& group : groups_) {
    if (group.name != name) {
      names.push_back(group.name);
      continue;
    }
    HelpTable table;
    for (const Option* option : OptionsOf(name)) table.Add(RowOf(*option));
    return Join(Wrapped("s2gs " + command_ + ", " + name + ": " + group.about, kHelpWidth), "\n", "") +
           "\n\n" + kOptionsTitle + table.Text();
  }
  if (names.empty()) throw CommandLineError(command_ + " has no groups of options, so that -h takes no name");
  const std::vector<std::string> nearest = NearestWords(name, names);
  throw CommandLineError("there is no group " + name + " of options. " +
                         (nearest.empty() ? "The groups are " + Join(names, ", ", "") + "."
                                          : "Did you mean " + Join(nearest, " or ", "") + "?"));
}

std::map<std::string, std::string> Options::Values() const {
  std::map<std::string, std::string> values;
  for (const auto& option : options_) {
    if (option->name_ != kProjectPath && option->name_ != kLogLevel) values[option->name_] = option->get_();
  }
  return values;
}

std::map<std::string, std::string> Options::Values(const std::string& group) const {
  std::map<std::string, std::string> values;
  for (const auto& option : options_) {
    if (GroupOf(option->name_) == group && !group.empty()) values[option->name_] = option->get_();
  }
  return values;
}

bool Options::IsGiven(const std::string& name) const {
  const Option* option = Find(name);
  S2GS_INVARIANT(option != nullptr);
  return !option->given_by_.empty();
}

}  // namespace s2gs
