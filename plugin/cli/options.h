#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "plugin/cli/help_table.h"
#include "plugin/cli/option_value.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// A command line that asks for something that does not exist or is out of bounds. Exit code 2.
class CommandLineError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Thrown by Options::Parse for -h and --help; what() is the help that is asked for.
class HelpRequested : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// One option's declaration, returned by Add() to say more about it.
class Option {
 public:
  /// There is no default: the command line or the project file must give it.
  Option& Required() {
    is_required_ = true;
    return *this;
  }
  /// The unit of the value, as the help shows it: "px", "m", "degrees".
  Option& Unit(const std::string& unit) {
    unit_ = unit;
    return *this;
  }

 private:
  friend class Options;
  template <typename Struct>
  friend class OptionGroup;

  std::string name_;   // "field" or "Group.field"
  std::string group_;  // under which the help lists it; empty: among the command's own
  std::string help_;   // one sentence
  std::string kind_;   // what kind of value
  std::string unit_;   // may be empty
  std::string bound_;  // may be empty
  std::string default_;
  bool is_required_ = false;
  std::function<void(const std::string&)> set_;
  std::function<std::string()> get_;
  std::string given_by_;  // where its value came from; empty while it is the default
};

/// The names of an enumeration's values, in the order in which the help lists them. A value may have several
/// names: the first is the one shown as default.
template <typename Enum>
using EnumNames = std::vector<std::pair<std::string, Enum>>;

template <typename Struct>
class OptionGroup;

/// The options of one command, bound to variables that hold their defaults.
///
///     std::filesystem::path workspace_path;
///     TsdfOptions tsdf;                                       // has OptionCheck Check() const
///     Options options("tsdf_mesher", "Fuses depth maps into a mesh.", "--workspace_path scan");
///     options.Add("workspace_path", &workspace_path, "the workspace").Required();
///     auto group = options.Group("Tsdf", &tsdf, "how depth maps are fused");
///     group.Add("voxel_size", &TsdfOptions::voxel_size, "edge of a voxel").Unit("m");
///     options.Parse(arguments);
///
/// makes `--workspace_path PATH` and `--Tsdf.voxel_size NUMBER`. Every command also has --project_path,
/// --random_seed, --log_level, -h and --help. -h lists the command's own options and names each group in one
/// line, `-h GROUP` lists those of one group, --help lists all. The bounds in the help are those that Check()
/// names.
class Options {
 public:
  /// \param command  the command's name.
  /// \param summary  one or two sentences for the top of the help.
  /// \param example  the arguments of a typical use, without the program's and the command's name.
  Options(std::string command, std::string summary, std::string example);
  Options(const Options&) = delete;
  Options& operator=(const Options&) = delete;

  /// Binds a variable, whose value is the default and which must outlive Parse. Types: bool, int32_t,
  /// int64_t, uint32_t, uint64_t, float, double, std::string, std::filesystem::path, and std::optional or
  /// (comma-separated) std::vector of these.
  /// \param name  without dashes.
  /// \param help  what it means, a phrase without capital and full stop.
  template <typename T>
  Option& Add(const std::string& name, T* target, const std::string& help) {
    return AddOption(
        name, ValueKind<T>(), [target](const std::string& text) { ParseValue(text, target); },
        [target] { return FormatValue(*target); }, help);
  }

  /// Binds an enumeration.
  template <typename Enum>
  Option& AddEnum(const std::string& name, Enum* target, const EnumNames<Enum>& names,
                  const std::string& help) {
    std::string list;
    for (const auto& entry : names) list += (list.empty() ? "" : ", ") + entry.first;
    const auto set = [target, names, list](const std::string& text) {
      for (const auto& [value_name, value] : names) {
        if (value_name == text) {
          *target = value;
          return;
        }
      }
      throw BadValue("is none of " + list);
    };
    const auto get = [target, names]() -> std::string {
      for (const auto& [value_name, value] : names) {
        if (value == *target) return value_name;
      }
      return "?";
    };
    return AddOption(name, "NAME", set, get, help + ": one of " + list);
  }

  /// Options that are the fields of a struct, which must outlive Parse. Its Check() is called by Parse.
  /// \param group  the part of their names before the point.
  /// \param about  what they are for, a phrase of one line.
  template <typename Struct>
  OptionGroup<Struct> Group(const std::string& group, Struct* fields, const std::string& about) {
    AddGroup(group, about);
    checks_.emplace_back(group, [fields] { return fields->Check(); });
    return OptionGroup<Struct>(this, group, fields);
  }

  /// The same for fields whose names have no part before a point.
  template <typename Struct>
  OptionGroup<Struct> Fields(Struct* fields) {
    checks_.emplace_back("", [fields] { return fields->Check(); });
    return OptionGroup<Struct>(this, "", fields);
  }

  /// A group of the help alone: what `add` adds has names without it.
  void Section(const std::string& name, const std::string& about, const std::function<void()>& add);

  /// Sets the bound variables from `arguments` (the words after the command's name) and from the file given
  /// as
  /// --project_path; the command line wins. Throws HelpRequested, CommandLineError for unknown, misspelt,
  /// repeated, missing or out-of-bounds options, and UserError when the project file cannot be read.
  void Parse(const std::vector<std::string>& arguments);

  /// What `-h` prints: the command's own options, and a line for each group.
  std::string Help() const;
  /// What `--help` prints: all options.
  std::string FullHelp() const;
  /// What `-h GROUP` prints. Throws CommandLineError when there is no such group.
  std::string GroupHelp(const std::string& name) const;

  /// Name and value of every option that changes results: all but --project_path, --log_level.
  std::map<std::string, std::string> Values() const;
  /// The same for one group only.
  std::map<std::string, std::string> Values(const std::string& group) const;

  /// Whether the command line or the project file gave this option.
  bool IsGiven(const std::string& name) const;

  const std::string& command() const { return command_; }
  uint64_t random_seed() const { return random_seed_; }
  LogLevel log_level() const { return log_level_; }

 private:
  template <typename Struct>
  friend class OptionGroup;

  Option& AddOption(const std::string& name, const std::string& kind,
                    std::function<void(const std::string&)> set, std::function<std::string()> get,
                    const std::string& help);
  struct GroupInfo {
    std::string name, about;
  };
  void AddGroup(const std::string& name, const std::string& about);
  std::vector<const Option*> OptionsOf(const std::string& group) const;
  static HelpRow RowOf(const Option& option);
  std::string HelpHead() const;
  HelpTable OwnTable() const;
  Option* Find(const std::string& name) const;
  /// `given_by` says in messages where the value stands: "" for the command line, else "FILE, line N".
  void Set(Option& option, const std::string& value, const std::string& given_by);
  using Given = std::pair<Option*, std::string>;  // an option of the command line and its value
  std::vector<Given> ReadArguments(const std::vector<std::string>& arguments) const;
  void ApplyProjectFile();
  void CheckRequired() const;
  void CheckBounds() const;
  /// `shown` is the option as the user wrote it.
  [[noreturn]] void FailUnknown(const std::string& name, const std::string& shown,
                                const std::string& given_by) const;
  /// `argument` stands where an option should.
  [[noreturn]] void FailNoOption(const std::string& argument, const std::vector<Given>& given) const;
  [[noreturn]] static void FailNoValue(const Option& option);
  std::string Usage() const;
  std::string Example() const;

  std::string command_;
  std::string summary_;
  std::string example_;
  std::vector<std::unique_ptr<Option>> options_;
  std::vector<GroupInfo> groups_;
  std::string section_;  // that options are added to
  std::vector<std::pair<std::string, std::function<OptionCheck()>>> checks_;
  std::filesystem::path project_path_;
  uint64_t random_seed_ = 0;
  LogLevel log_level_ = LogLevel::kInfo;
};

/// Binds the fields of one struct; made by Options::Group.
template <typename Struct>
class OptionGroup {
 public:
  /// \param field   the field's name, as Check() reports it.
  template <typename T>
  Option& Add(const std::string& field, T Struct::*member, const std::string& help) {
    Option& option = options_->Add(FullName(field), &(fields_->*member), help);
    if constexpr (std::is_arithmetic_v<T> && !std::is_same_v<T, bool>) {
      using Limits = std::numeric_limits<T>;
      option.bound_ =
          BoundOf(field, member, {Limits::lowest(), Limits::max(), T(0), T(-1), Limits::quiet_NaN()});
    }
    return option;
  }

  template <typename Enum>
  Option& AddEnum(const std::string& field, Enum Struct::*member, const EnumNames<Enum>& names,
                  const std::string& help) {
    return options_->AddEnum(FullName(field), &(fields_->*member), names, help);
  }

 private:
  friend class Options;
  OptionGroup(Options* options, std::string group, Struct* fields)
      : options_(options), group_(std::move(group)), fields_(fields) {}

  std::string FullName(const std::string& field) const {
    return group_.empty() ? field : group_ + "." + field;
  }

  // The bounds are written once, in Check(): values that no bound admits make it say them.
  template <typename T>
  std::string BoundOf(const std::string& field, T Struct::*member, const std::vector<T>& probes) const {
    std::string bounds;
    for (const T probe : probes) {
      Struct copy = *fields_;
      copy.*member = probe;
      const OptionCheck fault = copy.Check();
      if (!fault.has_value() || fault->field != field || fault->bound.empty()) continue;
      if (bounds.find(fault->bound) != std::string::npos) continue;
      bounds += (bounds.empty() ? "" : ", ") + fault->bound;
    }
    return bounds;
  }

  Options* options_;
  std::string group_;
  Struct* fields_;
};

}  // namespace s2gs
