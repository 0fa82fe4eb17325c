#include "plugin/cli/options.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <map>
#include <optional>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

enum class Quality { kLow, kHigh };

struct FusionOptions {
  double voxel_size = 0.004;  // [m]
  float max_depth = 2.5F;     // [m]
  int num_threads = -1;
  bool use_color = true;
  int min_views = 3;
  Quality quality = Quality::kHigh;

  OptionCheck Check() const {
    if (!(voxel_size > 0)) return OptionFault{"voxel_size", std::to_string(voxel_size), "0 < voxel_size"};
    if (!(max_depth > 0 && max_depth <= 100)) {
      return OptionFault{"max_depth", std::to_string(max_depth), "0 < max_depth <= 100"};
    }
    if (num_threads < -1) return OptionFault{"num_threads", std::to_string(num_threads), "-1 <= num_threads"};
    if (min_views < 1) return OptionFault{"min_views", std::to_string(min_views), "1 <= min_views"};
    if (min_views > 1000) return OptionFault{"min_views", std::to_string(min_views), "min_views <= 1000"};
    return std::nullopt;
  }
};

struct Bound {
  std::filesystem::path workspace_path;
  std::filesystem::path output_path = "mesh.ply";
  std::string label = "none";
  int64_t budget = 5'000'000'000;
  uint32_t camera_id = 7;
  std::vector<double> params = {1, 0.5};
  std::optional<double> known_length;
  FusionOptions fusion;
  FusionOptions coarse;
  Options options{"fuser", "Fuses depth maps into a mesh.", "--workspace_path scan"};

  Bound() {
    options.Add("workspace_path", &workspace_path, "the workspace").Required();
    options.Add("output_path", &output_path, "where the mesh goes");
    auto group = options.Group("Fusion", &fusion, "how maps are fused");
    group.Add("voxel_size", &FusionOptions::voxel_size, "edge of a voxel").Unit("m");
    group.Add("max_depth", &FusionOptions::max_depth, "farthest depth used").Unit("m");
    group.Add("num_threads", &FusionOptions::num_threads, "threads; -1 is all");
    group.Add("use_color", &FusionOptions::use_color, "average the colours");
    group.Add("min_views", &FusionOptions::min_views, "views that see a voxel");
    group.AddEnum("quality", &FusionOptions::quality, {{"low", Quality::kLow}, {"high", Quality::kHigh}},
                  "how fine");
    auto other = options.Group("Coarse", &coarse, "the coarse pass");
    other.Add("min_views", &FusionOptions::min_views, "views, in the coarse pass");
    options.Section("Names", "what things are called", [&] {
      options.Add("label", &label, "a name for the report");
      options.Add("camera_id", &camera_id, "which camera");
    });
    options.Add("budget", &budget, "bytes of memory").Unit("B");
    options.Add("params", &params, "camera parameters").Unit("px");
    options.Add("known_length", &known_length, "diameter of the disc").Unit("m");
  }

  // The message of the CommandLineError for these arguments after --workspace_path scan.
  std::string Fault(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), {"--workspace_path", "scan"});
    return FaultOfAll(arguments);
  }
  std::string FaultOfAll(const std::vector<std::string>& arguments) {
    try {
      options.Parse(arguments);
    } catch (const CommandLineError& error) {
      return error.what();
    }
    return "no error";
  }
};

TEST(Options, DefaultsStay) {
  Bound b;
  b.options.Parse({"--workspace_path", "scan"});
  EXPECT_EQ(b.workspace_path, "scan");
  EXPECT_EQ(b.output_path, "mesh.ply");
  EXPECT_EQ(b.fusion.voxel_size, 0.004);
  EXPECT_EQ(b.budget, 5'000'000'000);
  EXPECT_FALSE(b.known_length.has_value());
  EXPECT_EQ(b.options.random_seed(), 0U);
  EXPECT_EQ(b.options.log_level(), LogLevel::kInfo);
  EXPECT_TRUE(b.options.IsGiven("workspace_path"));
  EXPECT_FALSE(b.options.IsGiven("label"));
}

TEST(Options, SetsEveryKindOfValue) {
  Bound b;
  b.options.Parse({"--workspace_path=my scan",
                   "--output_path",
                   "-odd name",
                   "--Fusion.voxel_size",
                   "2e-3",
                   "--Fusion.max_depth=1.25",
                   "--label",
                   "a=b",
                   "--Fusion.num_threads",
                   "-1",
                   "--Fusion.use_color",
                   "0",
                   "--budget",
                   "-9000000000",
                   "--camera_id=4294967295",
                   "--params",
                   "1,-2.5,3e10",
                   "--known_length",
                   "0.3",
                   "--Fusion.quality",
                   "low",
                   "--random_seed",
                   "18446744073709551615",
                   "--log_level",
                   "debug",
                   "--Coarse.min_views",
                   "1"});
  EXPECT_EQ(b.workspace_path, "my scan");
  EXPECT_EQ(b.output_path, "-odd name");
  EXPECT_EQ(b.fusion.voxel_size, 0.002);
  EXPECT_EQ(b.fusion.max_depth, 1.25F);
  EXPECT_EQ(b.label, "a=b");
  EXPECT_FALSE(b.fusion.use_color);
  EXPECT_EQ(b.budget, -9'000'000'000);
  EXPECT_EQ(b.camera_id, 4294967295U);
  EXPECT_EQ(b.params, (std::vector<double>{1, -2.5, 3e10}));
  EXPECT_EQ(b.known_length, 0.3);
  EXPECT_EQ(b.fusion.quality, Quality::kLow);
  EXPECT_EQ(b.options.random_seed(), ~uint64_t{0});
  EXPECT_EQ(b.options.log_level(), LogLevel::kDebug);
  EXPECT_EQ(b.coarse.min_views, 1);
  EXPECT_EQ(b.fusion.min_views, 3);
}

TEST(Options, LogLevelsByNumberAndName) {
  const std::vector<std::pair<std::string, LogLevel>> levels = {
      {"0", LogLevel::kDebug},         {"1", LogLevel::kInfo},      {"2", LogLevel::kWarning},
      {"3", LogLevel::kError},         {"debug", LogLevel::kDebug}, {"info", LogLevel::kInfo},
      {"warning", LogLevel::kWarning}, {"error", LogLevel::kError}};
  for (const auto& [text, level] : levels) {
    Bound b;
    EXPECT_EQ(b.Fault({"--log_level", text}), "no error");
    EXPECT_EQ(b.options.log_level(), level) << text;
  }
}

TEST(Options, BadValuesAreNamed) {
  const std::vector<std::pair<std::vector<std::string>, std::string>> cases = {
      {{"--Fusion.voxel_size", "0,5"},
       "--Fusion.voxel_size: \"0,5\" is not a number (decimals follow a point)"},
      {{"--Fusion.voxel_size", "1.5x"}, "\"1.5x\" is not a number"},
      {{"--Fusion.voxel_size", "1e999"}, "\"1e999\" is too large"},
      {{"--Fusion.voxel_size", "inf"}, "\"inf\" is not a finite number"},
      {{"--Fusion.voxel_size", "nan"}, "\"nan\" is not a finite number"},
      {{"--Fusion.voxel_size="}, "\"\" is not a number"},
      {{"--Fusion.voxel_size", " 1"}, "\" 1\" is not a number"},
      {{"--Fusion.max_depth", "1e39"}, "is too large"},
      {{"--Fusion.num_threads", "2.5"}, "\"2.5\" is not a whole number"},
      {{"--Fusion.num_threads", "0x10"}, "is not a whole number"},
      {{"--Fusion.num_threads", "3000000000"}, "whole numbers from -2147483648 to 2147483647"},
      {{"--camera_id", "-1"}, "is negative"},
      {{"--Fusion.use_color", "yes"}, "\"yes\" is neither 0 nor 1"},
      {{"--Fusion.use_color", "2"}, "is neither 0 nor 1"},
      {{"--Fusion.quality", "hihg"}, "\"hihg\" is none of low, high"},
      {{"--log_level", "4"}, "is none of debug, info, warning, error, 0, 1, 2, 3"},
      {{"--params", "1,,2"}, "is not a number"},
      {{"--output_path", ""}, "--output_path: \"\" is an empty path"},
  };
  for (const auto& [arguments, message] : cases) EXPECT_THAT(Bound().Fault(arguments), HasSubstr(message));
}

TEST(Options, MisspeltOptionsGetTheRightOneNamed) {
  const std::vector<std::pair<std::string, std::string>> cases = {
      {"--Fusion.voxel_siez", "unknown option --Fusion.voxel_siez. Did you mean --Fusion.voxel_size?"},
      {"--Fusoin.voxel_size", "voxel_size belongs to the group Fusion: --Fusion.voxel_size"},
      {"--voxel_size", "voxel_size belongs to the group Fusion: --Fusion.voxel_size"},
      {"--voxl_size", "Did you mean --Fusion.voxel_size?"},
      {"--Fusion.label", "label belongs to no group: --label"},
      {"--min_views", "Did you mean --Fusion.min_views or --Coarse.min_views?"},
      {"--Fusion.voxel-size", "Names have '_', not '-': --Fusion.voxel_size"},
      {"--fusion.voxel_size", "--Fusion.voxel_size"},
      {"--Label", "Did you mean --label?"},
      {"--lab", "Did you mean --label?"},
      {"-label", "options begin with two plain dashes: --label, not -label"},
      {"---label", "Did you mean --label?"},
      {"\xE2\x80\x93label", "two plain dashes: --label"},
      {"\xE2\x80\x94label", "two plain dashes: --label"},
      {"--Mesh.frobnicate", "There is no group Mesh here, only Coarse, Fusion"},
      {"--frobnicate", "unknown option --frobnicate."},
      {"label", "\"label\" after --workspace_path scan belongs to no option"},
      {"--", "unknown option --"},
      {"-", "unknown option -"},
  };
  for (const auto& [argument, message] : cases) {
    EXPECT_THAT(Bound().Fault({argument, "1"}), HasSubstr(message)) << argument;
    if (argument.compare(0, 3, "--l") == 0 || argument.find('.') != std::string::npos) {
      EXPECT_THAT(Bound().Fault({argument + "=1"}), HasSubstr(message)) << argument;
    }
  }
}

TEST(Options, AbbreviationsAndRepetitionsAreErrors) {
  EXPECT_THAT(Bound().Fault({"--known", "1"}), HasSubstr("Did you mean --known_length?"));
  EXPECT_THAT(Bound().Fault({"--label", "a", "--label=b"}), HasSubstr("--label is given twice"));
}

TEST(Options, MissingValues) {
  EXPECT_THAT(Bound().Fault({"--label"}), HasSubstr("--label needs a value: --label TEXT"));
  EXPECT_THAT(Bound().Fault({"--Fusion.use_color", "--label", "x"}),
              HasSubstr("--Fusion.use_color needs a value: --Fusion.use_color 0 or 1"));
  // A value that begins with dashes can be given.
  Bound b;
  EXPECT_EQ(b.Fault({"--label=--x"}), "no error");
  EXPECT_EQ(b.label, "--x");
}

TEST(Options, MissingRequiredOptionsComeWithTheExample) {
  EXPECT_THAT(Bound().FaultOfAll({}), AllOf(HasSubstr("missing: --workspace_path PATH"),
                                            HasSubstr("s2gs fuser --workspace_path scan")));
}

TEST(Options, BoundsComeFromCheck) {
  EXPECT_EQ(Bound().Fault({"--Fusion.voxel_size", "-1"}),
            "Fusion.voxel_size = -1.000000 violates 0 < voxel_size");
  EXPECT_EQ(Bound().Fault({"--Coarse.min_views", "0"}), "Coarse.min_views = 0 violates 1 <= min_views");
}

TEST(Options, ProjectFileSetsAndTheCommandLineWins) {
  const TemporaryFolder folder;
  const std::string ini = (folder / "scan.ini").string();
  WriteAll(ini,
           "workspace_path=from_file\nlabel=from file\nbudget=\nrandom_seed=5\n"
           "[Fusion]\nvoxel_size=0.5\nmin_views=9\nuse_color=false\nquality=low\n");
  Bound b;
  b.options.Parse({"--Fusion.min_views", "4", "--project_path", ini, "--label=from line"});
  EXPECT_EQ(b.workspace_path, "from_file");
  EXPECT_EQ(b.label, "from line");
  EXPECT_EQ(b.budget, 5'000'000'000);
  EXPECT_EQ(b.options.random_seed(), 5U);
  EXPECT_EQ(b.fusion.voxel_size, 0.5);
  EXPECT_EQ(b.fusion.min_views, 4);
  EXPECT_EQ(b.coarse.min_views, 3);
  EXPECT_FALSE(b.fusion.use_color);
  EXPECT_EQ(b.fusion.quality, Quality::kLow);
}

TEST(Options, ProjectFileFaultsNameFileAndLine) {
  const TemporaryFolder folder;
  const std::string ini = (folder / "scan.ini").string();
  const std::vector<std::pair<std::string, std::string>> cases = {
      {"label=a\nlabl=b\n", ", line 2: unknown option labl. Did you mean label?"},
      {"[Fusion]\nvoxel_siz=1\n",
       ", line 2: unknown option Fusion.voxel_siz. Did you mean Fusion.voxel_size?"},
      {"voxel_size=1\n",
       ", line 1: unknown option voxel_size. voxel_size belongs to the group Fusion: Fusion.voxel_size"},
      {"label=a\n\nlabel=b\n", ", line 3: label is already given in line 1"},
      {"[Fusion]\nvoxel_size=x\n", ", line 2: Fusion.voxel_size: \"x\" is not a number"},
      {"[Fusion]\nvoxel_size=-2\n", ", line 2: Fusion.voxel_size = -2.000000 violates 0 < voxel_size"},
      {"project_path=b.ini\n", ", line 1: a project file cannot name another one"},
  };
  for (const auto& [content, message] : cases) {
    WriteAll(ini, content);
    EXPECT_EQ(Bound().Fault({"--project_path", ini}), ini + message);
  }
  // Even where the command line overrides it, the file must be right.
  WriteAll(ini, "budget=many\n");
  EXPECT_THAT(Bound().Fault({"--project_path", ini, "--budget", "1"}),
              HasSubstr("\"many\" is not a whole number"));
  WriteAll(ini, "nonsense\n");
  ExpectUserError([&] { Bound().Fault({"--project_path", ini}); }, {ini, "line 1"});
  ExpectUserError([&] { Bound().Fault({"--project_path", "missing.ini"}); }, {"missing.ini: no such file"});
}

TEST(Options, HelpIsAskedForAnywhere) {
  for (const std::vector<std::string>& arguments :
       {std::vector<std::string>{"-h"}, {"--help"}, {"--wrong", "1", "-h"}, {"-h", "Fusion"}}) {
    EXPECT_THROW(Bound().options.Parse(arguments), HelpRequested);
  }
}

std::string Asked(const std::vector<std::string>& arguments) {
  try {
    Bound().options.Parse(arguments);
  } catch (const HelpRequested& help) {
    return help.what();
  }
  return "no help";
}

TEST(Options, WhichHelpIsAskedFor) {
  const Bound b;
  EXPECT_EQ(Asked({"-h"}), b.options.Help());
  EXPECT_EQ(Asked({"-h", "--help"}), b.options.Help());
  EXPECT_EQ(Asked({"--label", "a", "--help"}), b.options.FullHelp());
  EXPECT_EQ(Asked({"-h", "Coarse"}), b.options.GroupHelp("Coarse"));
  EXPECT_EQ(Asked({"--help", "Coarse", "-h"}), b.options.GroupHelp("Coarse"));
  EXPECT_THAT(Bound().FaultOfAll({"-h", "fusion"}),
              HasSubstr("there is no group fusion of options. Did you mean Fusion?"));
  EXPECT_THAT(Bound().FaultOfAll({"-h", "frobnicate"}), HasSubstr("The groups are Fusion, Coarse, Names."));
  Options plain("c", "Does things.", "");
  EXPECT_THROW(plain.Parse({"-h", "Fusion"}), CommandLineError);
}

// The help's line for an option, with the lines that continue it joined and runs of spaces made one.
std::string HelpLine(const std::string& help, const std::string& option) {
  std::istringstream stream(help);
  std::string result;
  bool is_inside = false;
  for (std::string line; std::getline(stream, line);) {
    const bool begins = line.rfind("  --", 0) == 0 || line.rfind("  -h", 0) == 0;
    if (begins) is_inside = line.rfind("  --" + option + " ", 0) == 0;
    if (line.empty()) is_inside = false;
    if (is_inside) result += line + " ";
  }
  std::string single;
  for (const char c : result) {
    if (c != ' ' || (!single.empty() && single.back() != ' ')) single += c;
  }
  return single.empty() ? single : single.substr(0, single.size() - 1);
}

TEST(OptionsHelp, ListsEachOptionWithDefaultUnitAndBounds) {
  const std::string help = Bound().options.FullHelp();
  EXPECT_EQ(HelpLine(help, "workspace_path"), "--workspace_path PATH required the workspace");
  EXPECT_EQ(HelpLine(help, "output_path"), "--output_path PATH mesh.ply where the mesh goes");
  EXPECT_EQ(HelpLine(help, "Fusion.voxel_size"),
            "--Fusion.voxel_size NUMBER 0.004 m edge of a voxel (0 < voxel_size)");
  EXPECT_EQ(HelpLine(help, "Fusion.max_depth"),
            "--Fusion.max_depth NUMBER 2.5 m farthest depth used (0 < max_depth <= 100)");
  EXPECT_EQ(HelpLine(help, "Fusion.num_threads"),
            "--Fusion.num_threads INT -1 threads; -1 is all (-1 <= num_threads)");
  EXPECT_EQ(HelpLine(help, "Fusion.use_color"), "--Fusion.use_color 0|1 1 average the colours");
  EXPECT_EQ(HelpLine(help, "Fusion.min_views"),
            "--Fusion.min_views INT 3 views that see a voxel (1 <= min_views, min_views <= 1000)");
  EXPECT_EQ(HelpLine(help, "Fusion.quality"), "--Fusion.quality NAME high how fine: one of low, high");
  EXPECT_EQ(HelpLine(help, "budget"), "--budget INT 5000000000 B bytes of memory");
  EXPECT_EQ(HelpLine(help, "params"), "--params NUMBER,... 1,0.5 px camera parameters");
  EXPECT_EQ(HelpLine(help, "known_length"), "--known_length NUMBER - m diameter of the disc");
  EXPECT_THAT(HelpLine(help, "project_path"), HasSubstr("the command line wins"));
  EXPECT_THAT(HelpLine(help, "random_seed"), HasSubstr(" 0 "));
  EXPECT_THAT(HelpLine(help, "log_level"), HasSubstr("info"));
  EXPECT_THAT(help, AllOf(HasSubstr("Usage:\n  s2gs fuser --workspace_path PATH [options]"),
                          HasSubstr("Example:\n  s2gs fuser --workspace_path scan"),
                          HasSubstr("  -h [GROUP]"), HasSubstr("  --help  ")));
}

// The options whose rows a help has, in order.
std::vector<std::string> Listed(const std::string& help) {
  std::vector<std::string> names;
  std::istringstream stream(help);
  for (std::string line; std::getline(stream, line);) {
    if (line.rfind("  --", 0) == 0) names.push_back(line.substr(4, line.find(' ', 4) - 4));
  }
  return names;
}

TEST(OptionsHelp, ShortOneNamesGroupsInOneLineEach) {
  const Bound b;
  const std::vector<std::string> own = {"workspace_path", "output_path", "budget", "params", "known_length"};
  const std::vector<std::string> standard = {"project_path", "random_seed", "log_level", "help"};
  const std::vector<std::string> fusion = {"Fusion.voxel_size", "Fusion.max_depth", "Fusion.num_threads",
                                           "Fusion.use_color",  "Fusion.min_views", "Fusion.quality"};
  std::vector<std::string> listed = own;
  listed.insert(listed.end(), standard.begin(), standard.end());
  EXPECT_EQ(Listed(b.options.Help()), listed);
  EXPECT_THAT(b.options.Help(),
              HasSubstr("\nGroups of more options (`s2gs fuser -h Fusion` lists those of one):\n"
                        "  Fusion  6  how maps are fused\n"
                        "  Coarse  1  the coarse pass\n"
                        "  Names   2  what things are called\n"));
  EXPECT_EQ(Listed(b.options.GroupHelp("Fusion")), fusion);
  EXPECT_EQ(Listed(b.options.GroupHelp("Names")), (std::vector<std::string>{"label", "camera_id"}));
  EXPECT_EQ(HelpLine(b.options.GroupHelp("Names"), "label"), "--label TEXT none a name for the report");
  EXPECT_THAT(b.options.GroupHelp("Names"), HasSubstr("s2gs fuser, Names: what things are called\n"));

  listed.insert(listed.end(), fusion.begin(), fusion.end());
  listed.insert(listed.end(), {"Coarse.min_views", "label", "camera_id"});
  EXPECT_EQ(Listed(b.options.FullHelp()), listed);
  EXPECT_THAT(b.options.FullHelp(), HasSubstr("\n\nCoarse: the coarse pass\n  --Coarse.min_views "));
}

TEST(OptionsHelp, WithoutGroupsBothAreOne) {
  int count = 0;
  Options options("c", "Does things.", "");
  options.Add("count", &count, "how many");
  EXPECT_EQ(options.Help(), options.FullHelp());
  EXPECT_THAT(options.Help(), AllOf(HasSubstr("  -h, --help "), Not(HasSubstr("roups"))));
}

TEST(OptionsHelp, IsAlignedAndFits) {
  const std::string help = Bound().options.FullHelp();
  std::istringstream stream(help);
  size_t meaning = std::string::npos;
  int num_options = 0;
  for (std::string line; std::getline(stream, line);) {
    EXPECT_LE(line.size(), 110U) << line;
    EXPECT_TRUE(line.empty() || line.back() != ' ') << line;
    if (line.find("meaning (bounds)") != std::string::npos) meaning = line.find("meaning");
    if (line.rfind("  -", 0) != 0) continue;
    ++num_options;
    ASSERT_NE(meaning, std::string::npos);
    ASSERT_GT(line.size(), meaning) << line;
    EXPECT_EQ(line.substr(meaning - 2, 2), "  ") << line;
    EXPECT_NE(line[meaning], ' ') << line;
  }
  EXPECT_EQ(num_options, 19);
}

TEST(OptionsHelp, LongDefaultsKeepTheColumns) {
  std::string text(60, 'x');
  Options options("c", "Does things.", "");
  options.Add("text", &text, "a long one");
  EXPECT_THAT(options.Help(),
              HasSubstr("--text TEXT          " + text + "\n                                a long one\n"));
}

TEST(Options, ValuesAreThoseThatChangeResults) {
  Bound b;
  b.options.Parse({"--workspace_path", "scan", "--Fusion.voxel_size", "0.1", "--log_level", "0"});
  const auto all = b.options.Values();
  EXPECT_EQ(all.at("Fusion.voxel_size"), "0.1");
  EXPECT_EQ(all.at("random_seed"), "0");
  EXPECT_EQ(all.count("log_level"), 0U);
  EXPECT_EQ(all.count("project_path"), 0U);
  const auto group = b.options.Values("Coarse");
  EXPECT_EQ(group, (std::map<std::string, std::string>{{"Coarse.min_views", "3"}}));
}

TEST(OptionValue, TextsReadBackAsTheSameValue) {
  for (const double value : {0.1, 1.0 / 3, 1e-300, -2.5, 0.006666666666666667,
                             std::numeric_limits<double>::max(), std::numeric_limits<double>::denorm_min()}) {
    double back = 0;
    ParseValue(FormatValue(value), &back);
    EXPECT_EQ(back, value);
  }
  float back = 0;
  ParseValue(FormatValue(0.1F), &back);
  EXPECT_EQ(back, 0.1F);
  EXPECT_EQ(FormatValue(0.1F), "0.1");
  for (const int64_t value : {std::numeric_limits<int64_t>::min(), std::numeric_limits<int64_t>::max()}) {
    int64_t integer = 0;
    ParseValue(FormatValue(value), &integer);
    EXPECT_EQ(integer, value);
  }
}

}  // namespace
}  // namespace s2gs
