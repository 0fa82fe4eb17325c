#include <gmock/gmock.h>
#include <gtest/gtest.h>

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
    const ProcessResult help = S2gs({command.name, "-h"});
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
