#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <map>
#include <sstream>
#include <string>
#include <vector>

#include "plugin/cli/command.h"
#include "plugin/cli/version.h"
#include "tests/plugin/commands/subprocess.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

// The real executable.
ProcessResult S2gs(std::vector<std::string> arguments, const std::string& stdout_path = "") {
  arguments.insert(arguments.begin(), S2GS_PROGRAM);
  return RunProcess(arguments, stdout_path);
}

TEST(Program, HelpGoesToTheStandardOutput) {
  const ProcessResult help = S2gs({"help"});
  EXPECT_EQ(help.exit_code, 0);
  EXPECT_THAT(help.err, IsEmpty());
  EXPECT_THAT(help.out,
              AllOf(HasSubstr("Commands:"), HasSubstr("  workspace_info  "), HasSubstr("Exit codes:")));
  EXPECT_EQ(S2gs({"-h"}).out, help.out);
  EXPECT_EQ(S2gs({}).out, help.out);
  EXPECT_THAT(S2gs({"--version"}).out, ::testing::StartsWith(VersionText() + "\n"));
}

TEST(Program, EveryCommandExplainsItself) {
  for (const Command& command : AllCommands()) {
    const ProcessResult help = S2gs({command.name, "--help"});
    EXPECT_EQ(help.exit_code, 0) << command.name;
    EXPECT_THAT(help.out, AllOf(HasSubstr("s2gs " + command.name + ": "), HasSubstr("--project_path"),
                                HasSubstr("--log_level")));
    EXPECT_THAT(S2gs({"help"}).out, HasSubstr(command.summary));
    // The example uses options that exist, all required ones among them.
    const size_t begin = help.out.find("Example:\n");
    ASSERT_NE(begin, std::string::npos);
    const std::string example = help.out.substr(begin, help.out.find("\n\n", begin) - begin);
    const std::string list = help.out.substr(help.out.find("Options ("));
    std::istringstream words(example);
    for (std::string word; words >> word;) {
      if (word.rfind("--", 0) == 0) {
        EXPECT_THAT(list, HasSubstr("  " + word + " ")) << command.name;
      }
    }
    std::istringstream lines(list);
    for (std::string line; std::getline(lines, line);) {
      std::istringstream cells(line);
      std::string option;
      std::string kind;
      std::string value;
      cells >> option >> kind >> value;
      if (value == "required") {
        EXPECT_THAT(example, HasSubstr(option + " ")) << command.name;
      }
    }
  }
}

// The lines that begin with an option, and their options.
std::map<std::string, std::string> OptionLines(const std::string& help) {
  std::map<std::string, std::string> lines;
  std::istringstream stream(help);
  for (std::string line; std::getline(stream, line);) {
    if (line.rfind("  --", 0) == 0) lines[line.substr(2, line.find(' ', 2) - 2)] = line;
  }
  return lines;
}

// What -h leaves out stands in the groups that it names, all together in --help.
TEST(Program, ShortHelpAndGroupsAreAllOptions) {
  for (const Command& command : AllCommands()) {
    const std::string brief = S2gs({command.name, "-h"}).out;
    std::map<std::string, std::string> listed = OptionLines(brief);
    const size_t groups = brief.find("\nGroups of more options (");
    std::istringstream lines(groups == std::string::npos ? "" : brief.substr(groups + 1));
    std::string line;
    std::getline(lines, line);
    while (std::getline(lines, line)) {
      EXPECT_LE(line.size(), 110U) << line;
      std::istringstream cells(line);
      std::string group, about;
      size_t count = 0;
      cells >> group >> count >> about;
      EXPECT_FALSE(about.empty()) << command.name << ": " << line;
      const std::map<std::string, std::string> of_group = OptionLines(S2gs({command.name, "-h", group}).out);
      EXPECT_EQ(of_group.size(), count) << command.name << " " << group;
      for (const auto& [option, row] : of_group) {
        EXPECT_TRUE(listed.emplace(option, row).second) << command.name << ": " << option << " twice";
      }
    }
    const std::map<std::string, std::string> all = OptionLines(S2gs({command.name, "--help"}).out);
    EXPECT_EQ(listed.size(), all.size()) << command.name;
    for (const auto& [option, row] : all)
      EXPECT_EQ(listed.count(option), 1U) << command.name << " " << option;
  }
}

TEST(Program, EveryCommandRefusesWrongLines) {
  for (const Command& command : AllCommands()) {
    const ProcessResult unknown = S2gs({command.name, "--log_levle", "1"});
    EXPECT_EQ(unknown.exit_code, 2) << command.name;
    EXPECT_THAT(unknown.out, IsEmpty());
    EXPECT_THAT(unknown.err,
                AllOf(HasSubstr("s2gs: error: unknown option --log_levle. Did you mean --log_level?"),
                      HasSubstr("`s2gs " + command.name + " -h`")));
  }
}

TEST(Program, ExitCodes) {
  EXPECT_EQ(S2gs({"workspce_info"}).exit_code, 2);
  EXPECT_EQ(S2gs({"workspace_info"}).exit_code, 2);
  EXPECT_EQ(S2gs({"workspace_info", "--workspace_path", "/no/such/folder"}).exit_code, 1);
  const TemporaryFolder folder;
  EXPECT_EQ(S2gs({"workspace_info", "--workspace_path", folder.path().string()}).exit_code, 0);
}

// Options that do not go together, or lie beyond a bound that no single option's range says; and that their
// neighbours are taken, which fail later with exit code 1.
TEST(Program, RefusesOptionsThatDoNotGoTogether) {
  const TemporaryFolder folder;
  const std::string w = folder.path().string();
  struct Line {
    std::vector<std::string> words;
    const char* message;
  };
  for (const Line& line : std::vector<Line>{
           {{"work_precision", "--workspace_path", w, "--knob", "joint_tolerance", "--jobs", "0"},
            "--jobs is below 1."},
           {{"work_precision", "--workspace_path", w}, "give one of --knob, --forced and --curves, or"},
           {{"work_precision", "--workspace_path", w, "--knob", "joint_tolerance", "--forced", "pairs"},
            "give one of --knob, --forced and --curves, or"},
           {{"work_precision", "--knob", "joint_tolerance"}, "--workspace_path is missing."},
           {{"work_precision", "--workspace_path", w, "--curves", "a.json"},
            "--curves needs no --workspace_path."},
           {{"work_precision", "--curves", "a.json"}, "--output_path is missing."},
           {{"scan_evaluator", "--workspace_path", w}, "needs --ground_truth_path"},
           {{"scan_evaluator", "--ground_truth_path", w}, "nothing to measure"},
           {{"scan_planner"}, "give --workspace_path, --image_path or both."},
           {{"tsdf_mesher", "--workspace_path", w, "--max_error_voxels", "-0.1"},
            "--max_error_voxels must not be negative"},
           {{"gaussian_renderer", "--workspace_path", w, "--num_frames", "-1"},
            "--num_frames must not be negative"},
           {{"photo_importer", "--workspace_path", w, "--image_path", w, "--video_frames", "2"},
            "video_frames"},
           {{"mesh_texturer", "--workspace_path", w, "--test_every", "1"}, "test_every"},
           {{"gaussian_trainer", "--workspace_path", w, "--gpu_index", "-1"}, "gpu_index"}}) {
    const ProcessResult result = S2gs(line.words);
    EXPECT_EQ(result.exit_code, 2) << line.words[0] << ": " << result.err;
    EXPECT_THAT(result.err, HasSubstr(line.message));
    EXPECT_THAT(result.out, IsEmpty());
  }
  for (const std::vector<std::string>& words :
       {std::vector<std::string>{"work_precision", "--workspace_path", w, "--knob", "joint_tolerance",
                                 "--jobs", "1"},
        {"work_precision", "--curves", "none.json", "--output_path", w + "/curve"},
        {"tsdf_mesher", "--workspace_path", w, "--max_error_voxels", "0"},
        {"gaussian_renderer", "--workspace_path", w, "--num_frames", "0"},
        {"mesh_texturer", "--workspace_path", w, "--test_every", "2"},
        {"gaussian_trainer", "--workspace_path", w, "--gpu_index", "0"}}) {
    const ProcessResult result = S2gs(words);
    EXPECT_EQ(result.exit_code, 1) << words[0] << ": " << result.err;
  }
}

TEST(Program, FailsWhenItsOutputCannotBeWritten) {
  const ProcessResult result = S2gs({"help"}, "/dev/full");
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_THAT(result.err, HasSubstr("standard output"));
}

TEST(Program, WorkspaceInfoListsStagesAndFiles) {
  const TemporaryFolder folder;
  WriteAll(folder / "images/a.jpg", std::string(1500, 'x'));
  WriteAll(folder / "images/sub/b.jpg", std::string(500, 'x'));
  WriteAll(folder / "database.db", std::string(2'500'000, 'x'));
  WriteAll(folder / "s2gs/stages/tsdf_mesher.json", "{ half of a st");
  const ProcessResult result = S2gs({"workspace_info", "--workspace_path", folder.path().string()});
  EXPECT_EQ(result.exit_code, 0);
  EXPECT_THAT(result.out, ::testing::ContainsRegex("feature_extractor +present "));
  EXPECT_THAT(result.out, ::testing::ContainsRegex("tsdf_mesher +missing\n"));
  EXPECT_THAT(result.out, ::testing::ContainsRegex("images/ +2\\.0 kB +2 files +photos\n"));
  EXPECT_THAT(result.out, ::testing::ContainsRegex("database\\.db +2\\.5 MB +features and matches\n"));
  // What is not there is not listed.
  for (const char* missing : {"turntable.json", "point_cloud.ply", "report.html"})
    EXPECT_THAT(result.out, ::testing::Not(HasSubstr(missing)));
  EXPECT_THAT(result.err,
              AllOf(HasSubstr("warning"), HasSubstr("tsdf_mesher.json"), HasSubstr("counts as not done")));
}

TEST(Program, ReadsItsProjectFile) {
  const TemporaryFolder folder;
  WriteAll(folder / "scan.ini", "workspace_path=" + folder.path().string() + "\n");
  EXPECT_EQ(S2gs({"workspace_info", "--project_path", (folder / "scan.ini").string()}).exit_code, 0);
  WriteAll(folder / "bad.ini", "\nworkspace=x\n");
  const ProcessResult result = S2gs({"workspace_info", "--project_path", (folder / "bad.ini").string()});
  EXPECT_EQ(result.exit_code, 2);
  EXPECT_THAT(result.err, HasSubstr((folder / "bad.ini").string() +
                                    ", line 2: unknown option workspace. Did you mean workspace_path?"));
}

}  // namespace
}  // namespace s2gs
