#include "plugin/colmap/colmap_process.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <filesystem>
#include <string>
#include <thread>
#include <tuple>
#include <vector>

#include "sfm_split/base/error.h"
#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

class Recorder : public Reporter {
 public:
  void Log(LogLevel /*level*/, std::string_view message) override {
    log += std::string(message) + "\n";
    if (!stop_at.empty() && message == stop_at) stop = true;
  }
  void Progress(std::string_view task, int64_t done, int64_t total) override {
    progress.emplace_back(task, done, total);
  }
  bool StopRequested() const override { return stop; }

  std::string log;
  std::string stop_at;  // a line of output at which the user asks to stop
  std::vector<std::tuple<std::string, int64_t, int64_t>> progress;
  bool stop = false;
};

// A shell script in place of the executable. It answers `help`, and `COMMAND -h` with `options`; any other
// command runs `body` in the test's folder.
class FakeColmap : public ::testing::Test {
 protected:
  void Install(const std::string& body, const std::string& options = "  --database_path arg",
               const std::string& first_line = "COLMAP 4.2.1 (Commit abc on 2026-01-01 with CUDA)") {
    WriteAll(folder_ / "colmap",
             "#!/bin/sh\n"
             "if [ \"$1\" = help ]; then\n"
             "  printf '%s\\n' '" +
                 first_line +
                 "' 'Available commands:' '  feature_extractor' '  mapper'\n"
                 "  exit 0\n"
                 "fi\n"
                 "if [ \"$2\" = -h ]; then cat >&2 <<'END'\n" +
                 options +
                 "\nEND\n"
                 "  exit 0\n"
                 "fi\n"
                 "cd '" +
                 folder_.path().string() + "'\n" + body + "\n");
    ::chmod((folder_ / "colmap").c_str(), 0755);
  }
  ColmapProgram Find() {
    return ColmapProgram::Find(folder_ / "colmap", reporter_, {{milliseconds(20), milliseconds(20)}});
  }
  void Run(std::vector<ColmapOutput> outputs = {}, std::vector<ColmapOption> options = {}) {
    ColmapProgram program = Find();
    program.Run({"feature_extractor", std::move(options), std::move(outputs)}, reporter_);
  }

  TemporaryFolder folder_;
  Recorder reporter_;
};

TEST_F(FakeColmap, VersionAndCommandsAreRead) {
  Install("");
  EXPECT_EQ(Find().version(), "4.2.1");
  EXPECT_TRUE(Find().has_cuda());
  EXPECT_TRUE(Find().HasCommand("mapper"));
  EXPECT_FALSE(Find().HasCommand("patch_match_stereo"));
  Install("", "", "COLMAP 3.9 (Commit abc without CUDA)");
  EXPECT_EQ(Find().version(), "3.9");
  EXPECT_FALSE(Find().has_cuda());
  EXPECT_EQ(ColmapProgram::Find(folder_.path(), reporter_).path(), folder_ / "colmap");
}

TEST_F(FakeColmap, IsFoundOnPath) {
  Install("");
  const std::string old_path = ::getenv("PATH");
  ::setenv("PATH", ("/nonexistent::" + folder_.path().string() + ":" + old_path).c_str(), 1);
  const fs::path found = ColmapProgram::Find("", reporter_).path();
  ::setenv("PATH", "/nonexistent", 1);
  ExpectUserError([&] { ColmapProgram::Find("", reporter_); },
                  {"colmap", "not on PATH", "apt install colmap"});
  ::setenv("PATH", old_path.c_str(), 1);
  EXPECT_EQ(found, folder_ / "colmap");
}

TEST_F(FakeColmap, SilenceIsReported) {
  Install("sleep 0.5");
  ColmapPatience patience;
  patience.silence = milliseconds(100);
  ColmapProgram::Find(folder_ / "colmap", reporter_, patience).Run({"feature_extractor", {}, {}}, reporter_);
  EXPECT_THAT(reporter_.log, HasSubstr("colmap feature_extractor has printed nothing for 0 seconds"));
  Install("");
  reporter_.log.clear();
  Run();
  EXPECT_THAT(reporter_.log, Not(HasSubstr("printed nothing")));
}

TEST_F(FakeColmap, WhatDoesNotAnswerIsGivenUp) {
  WriteAll(folder_ / "colmap", "#!/bin/sh\nsleep 100\n");
  ::chmod((folder_ / "colmap").c_str(), 0755);
  ColmapPatience patience;
  patience.answer = milliseconds(100);
  ExpectUserError([&] { ColmapProgram::Find(folder_ / "colmap", reporter_, patience); },
                  {"does not answer `help`"});
}

TEST_F(FakeColmap, ACrashInsteadOfOptionsIsNamed) {
  WriteAll(folder_ / "colmap",
           "#!/bin/sh\nif [ \"$1\" = help ]; then\n  printf '%s\\n' 'COLMAP 3.8' 'Available commands:' '  "
           "mapper'\n"
           "  exit 0\nfi\necho broken\nkill -SEGV $$\n");
  ::chmod((folder_ / "colmap").c_str(), 0755);
  ColmapProgram program = Find();
  ExpectUserError(
      [&] {
        program.Run({"mapper", {{"database_path", "x"}}, {}}, reporter_);
      },
      {"cannot be asked for the options of mapper", "signal 11", "broken"});
}

TEST_F(FakeColmap, WhatASignalEndsIsToldFromWhatFails) {
  for (const char* signal : {"XFSZ", "KILL", "SEGV"}) {
    Install(std::string("kill -") + signal + " $$");
    EXPECT_THROW(Run(), ColmapKilled) << signal;
  }
  Install("exit 1");
  try {
    Run();
    FAIL();
  } catch (const ColmapKilled&) {
    FAIL();
  } catch (const UserError&) {
  }
}

TEST_F(FakeColmap, WhatIsNotColmapIsRefused) {
  const auto find = [&] { Find(); };
  ExpectUserError(find, {(folder_ / "colmap").string(), "no such file", "--colmap_path"});
  WriteAll(folder_ / "colmap", "text");
  ExpectUserError(find, {(folder_ / "colmap").string(), "not an executable file"});
  ::chmod((folder_ / "colmap").c_str(), 0755);
  ExpectUserError(find, {(folder_ / "colmap").string(), "cannot be started (Exec format error)"});
  WriteAll(folder_ / "colmap", "#!/bin/sh\necho 'error while loading shared libraries' >&2\nexit 127\n");
  ExpectUserError(find, {"does not answer", "exit code 127", "loading shared libraries", "apt install"});
  WriteAll(folder_ / "colmap", "#!/bin/sh\necho hello\n");
  ExpectUserError(find, {"does not answer", "exit code 0"});
}

TEST_F(FakeColmap, OptionsAreSpelledAsTheVersionSpellsThem) {
  struct Case {
    const char* asked;
    const char* old_name;
    const char* new_name;
  };
  const std::vector<Case> cases = {
      {"FeatureExtraction.use_gpu", "SiftExtraction.use_gpu", "FeatureExtraction.use_gpu"},
      {"SiftExtraction.gpu_index", "SiftExtraction.gpu_index", "FeatureExtraction.gpu_index"},
      {"FeatureMatching.use_gpu", "SiftMatching.use_gpu", "FeatureMatching.use_gpu"},
      {"TwoViewGeometry.max_error", "SiftMatching.max_error", "TwoViewGeometry.max_error"},
      {"SiftMatching.confidence", "SiftMatching.confidence", "TwoViewGeometry.confidence"},
      {"SiftMatching.max_ratio", "SiftMatching.max_ratio", "SiftMatching.max_ratio"},
      {"Mapper.ba_global_frames_freq", "Mapper.ba_global_images_freq", "Mapper.ba_global_frames_freq"},
      {"Mapper.snapshot_images_freq", "Mapper.snapshot_images_freq", "Mapper.snapshot_frames_freq"},
      {"database_path", "database_path", "database_path"},
  };
  std::string old_options =
      "Options can either be specified via command-line or by defining\n  -h [ --help ]";
  std::string new_options = old_options;
  for (const Case& c : cases) {
    old_options += std::string("\n  --") + c.old_name + " arg (=-1)";
    new_options += std::string("\n  --") + c.new_name + " arg";
  }
  for (const bool is_new : {false, true}) {
    Install("", is_new ? new_options : old_options);
    ColmapProgram program = Find();
    for (const Case& c : cases) {
      EXPECT_EQ(program.SpellingOf("feature_extractor", c.asked, reporter_),
                is_new ? c.new_name : c.old_name);
    }
    EXPECT_EQ(program.SpellingOf("feature_extractor", "Mapper.none", reporter_), std::nullopt);
    EXPECT_EQ(program.SpellingOf("feature_extractor", "help", reporter_), std::nullopt);
  }
}

TEST_F(FakeColmap, ArgumentsArriveAsTheyAre) {
  Install("for a in \"$@\"; do echo \"<$a>\"; done; echo $QT_QPA_PLATFORM; cat; echo x > out",
          "  --SiftExtraction.use_gpu arg (=1)\n  --image_path arg");
  Run({{folder_ / "out"}}, {{"image_path", "a b'c\"$(d);*"},
                            {"FeatureExtraction.use_gpu", "0"},
                            {"Mapper.new_thing", "1", /*is_required=*/false}});
  EXPECT_THAT(reporter_.log, HasSubstr("\n<feature_extractor>\n<--image_path>\n<a b'c\"$(d);*>\n"
                                       "<--SiftExtraction.use_gpu>\n<0>\noffscreen\n"));
  EXPECT_THAT(reporter_.log, HasSubstr("no option --Mapper.new_thing: left out"));
  ExpectUserError(
      [&] {
        Run({}, {{"Mapper.new_thing", "1"}});
      },
      {"COLMAP 4.2.1 has no option --Mapper.new_thing for feature_extractor"});
  ColmapProgram program = Find();
  ExpectUserError(
      [&] {
        program.Run({"stereo_fusion", {}, {}}, reporter_);
      },
      {"has no command \"stereo_fusion\""});
}

TEST_F(FakeColmap, ProgressIsHandedOn) {
  // The last line stays unfinished until its progress has arrived here.
  class Answerer : public Recorder {
   public:
    explicit Answerer(fs::path answer) : answer_(std::move(answer)) {}
    void Progress(std::string_view task, int64_t done, int64_t total) override {
      Recorder::Progress(task, done, total);
      if (task == "match pairs") WriteAll(answer_, "");
    }

   private:
    fs::path answer_;
  } answerer(folder_ / "answer");
  Install(
      "exec >&2; echo 'Processed file [1/3]'; echo '  Name: a.jpg'\n"
      "printf 'I0101 10:00:00.1 7 extraction.cc:254] Processed file [2/3]\\r'\n"
      "printf 'Matching block [2/2, 1/2]'; printf ' in'\n"
      "while [ ! -e answer ]; do sleep 0.01; done; printf ' 0.1s\\n'; echo x > out");
  ColmapProgram program = Find();
  program.Run({"feature_extractor", {}, {{folder_ / "out"}}}, answerer);
  EXPECT_THAT(answerer.progress,
              ElementsAre(std::tuple("extract features", 1, 3), std::tuple("extract features", 2, 3),
                          std::tuple("match pairs", 2, 4), std::tuple("match pairs", 4, 4)));
  EXPECT_THAT(answerer.log, HasSubstr("\nMatching block [2/2, 1/2] in 0.1s\n"));
}

TEST(ColmapProgress, LinesOfAllVersions) {
  const auto expect = [](const char* line, std::string_view task, int64_t done, int64_t total) {
    EXPECT_EQ(ParseColmapProgress(line), (ColmapProgress{task, done, total})) << line;
  };
  expect("Processed file [3/100]", "extract features", 3, 100);
  expect("I20260101 10:00:00.5 77 x.cc:254] Processed file [100/100]", "extract features", 100, 100);
  expect("Matching block [1/2, 1/2]", "match pairs", 0, 4);
  expect("Processing block [2/2, 2/2] in 3s", "match pairs", 3, 4);
  expect("Matching image [5/9] in 0.1s", "match pairs", 4, 9);
  expect("Registering image #7 (12)", "register images", 12, 0);
  expect("Registering image #7 (num_reg_frames=12)", "register images", 12, 0);
  expect("Triangulating image #7 (0)", "triangulate images", 0, 0);
  expect("Processing view 1 / 10 for a.jpg", "dense stereo", 0, 10);
  expect("Fusing image [2/10] with index 4", "fuse depth maps", 1, 10);
  expect("Undistorting image [2/10]", "undistort images", 1, 10);
  for (const char* line :
       {"", "Processed file [", "Processed file [3/10", "Processed file [3]", "Processed file [-3/10]",
        "Processed file [11/10]", "Processed file [0/0]", "Processed file [99999999999999999999/3]",
        "Matching block [1/2, 1/2", "Matching block [0/2, 1/2]", "Registering image #7",
        "Registering image #7 (12", "Processing view 1 / 1", "Elapsed time: 0.1 [minutes]"}) {
    EXPECT_EQ(ParseColmapProgress(line), std::nullopt) << line;
  }
}

TEST_F(FakeColmap, HugeOutputOnBothStreamsDoesNotBlock) {
  // About 2 MB on each stream, far more than a pipe holds, with one line of 1 MB.
  Install(
      "head -c 1000000 /dev/zero | tr '\\0' x; echo\n"
      "(yes 'to standard output' | head -n 100000) & (yes 'to standard error' | head -n 100000) >&2\n"
      "wait; echo done; echo x > out");
  Run({{folder_ / "out"}});
  EXPECT_THAT(reporter_.log, HasSubstr("\ndone\n"));
  EXPECT_GT(reporter_.log.size(), 3'000'000u);
  EXPECT_THAT(reporter_.log, HasSubstr("\n" + std::string(4096, 'x') + "\n"));
}

TEST_F(FakeColmap, FailuresTellWhatHappened) {
  Install("for i in 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21; do echo line $i; done; exit 3");
  try {
    Run({}, {{"database_path", "my db"}});
    ADD_FAILURE() << "no error";
  } catch (const UserError& e) {
    const std::string message = e.what();
    EXPECT_THAT(message, HasSubstr("colmap feature_extractor failed"));
    EXPECT_THAT(message, HasSubstr("feature_extractor --database_path 'my db'\n"));
    EXPECT_THAT(message, HasSubstr("exit code 3"));
    EXPECT_THAT(message, HasSubstr("\n  line 2\n"));
    EXPECT_THAT(message, HasSubstr("\n  line 21"));
    EXPECT_THAT(message, Not(HasSubstr("line 1\n")));
  }
  Install("echo 'Check failed: x' >&2; kill -ABRT $$");
  ExpectUserError([&] { Run(); }, {"ended by signal 6 (Aborted)", "Check failed: x"});
  // As a script that wraps the executable reports the same.
  Install("exit 134");
  ExpectUserError([&] { Run(); }, {"exit code 134", "output: nothing"});
}

TEST_F(FakeColmap, PromisedOutputsAreChecked) {
  const fs::path out = folder_ / "out";
  Install("echo nothing to do; exit 0");
  ExpectUserError([&] { Run({{out}}); }, {"did not write " + out.string(), "exit code 0", "nothing to do"});
  WriteAll(out, "");
  ExpectUserError([&] { Run({{out}}); }, {"did not write " + out.string()});
  WriteAll(out, "old");
  ExpectUserError([&] { Run({{out}}); }, {"left " + out.string() + " as it was"});
  Run({{out, /*may_be_unchanged=*/true}});

  Install("echo new > out");
  Run({{out}});
  Install("mkdir -p sparse/0; echo x > sparse/0/cameras.bin");
  Run({{folder_ / "sparse"}});
  Install("exit 0");
  ExpectUserError([&] { Run({{folder_ / "sparse"}}); }, {"left " + (folder_ / "sparse").string()});
  Install("echo xx > sparse/0/cameras.bin; exit 1");
  ExpectUserError([&] { Run({{folder_ / "sparse"}}); }, {"failed", "exit code 1"});
}

// Whether a process is there and more than a zombie, which its parent has only yet to notice.
bool IsRunning(pid_t pid) {
  const std::string status = ReadAll("/proc/" + std::to_string(pid) + "/stat");
  return !status.empty() && status.find(") Z ") == std::string::npos;
}

bool EndsSoon(pid_t pid) {
  for (int i = 0; i < 1000 && IsRunning(pid); ++i) std::this_thread::sleep_for(milliseconds(5));
  return !IsRunning(pid);
}

TEST_F(FakeColmap, InterruptionIsForwarded) {
  Install("trap 'echo finishing; echo x > out; exit 130' INT; echo ready; while :; do sleep 0.01; done");
  reporter_.stop_at = "ready";
  ColmapProgram program = ColmapProgram::Find(folder_ / "colmap", reporter_);
  EXPECT_THROW(program.Run({"feature_extractor", {}, {{folder_ / "out"}}}, reporter_), Interrupted);
  EXPECT_THAT(reporter_.log, HasSubstr("finishing"));
  EXPECT_EQ(ReadAll(folder_ / "out"), "x\n");
}

TEST_F(FakeColmap, WhatIgnoresInterruptionIsKilledWithItsChildren) {
  Install("trap '' INT TERM; sleep 1000 & echo $! > child; echo $$ > self; echo ready; wait; sleep 1000");
  reporter_.stop_at = "ready";
  EXPECT_THROW(Run(), Interrupted);
  EXPECT_FALSE(IsRunning(std::stoi(ReadAll(folder_ / "self"))));
  EXPECT_TRUE(EndsSoon(std::stoi(ReadAll(folder_ / "child"))));
}

TEST_F(FakeColmap, BackgroundProcessesDoNotHoldItUp) {
  Install("sleep 1000 & echo x > out");
  Run({{folder_ / "out"}});
  EXPECT_EQ(ReadAll(folder_ / "out"), "x\n");
}

TEST_F(FakeColmap, ExceptionsOfTheReporterEndIt) {
  class Thrower : public Reporter {
    void Log(LogLevel /*level*/, std::string_view message) override {
      if (message == "ready") throw UserError("stop");
    }
  } thrower;
  Install("echo $$ > self; echo ready; while :; do sleep 0.01; done");
  ColmapProgram program = Find();
  EXPECT_THROW(program.Run({"feature_extractor", {}, {}}, thrower), UserError);
  EXPECT_FALSE(IsRunning(std::stoi(ReadAll(folder_ / "self"))));
}

TEST_F(FakeColmap, EndsWhenWeAreKilled) {
  Install("echo $$ > self; mv self pid; exec sleep 1000");
  const pid_t runner = ::fork();
  ASSERT_GE(runner, 0);
  if (runner == 0) {
    Run();
    ::_exit(0);
  }
  while (!fs::exists(folder_ / "pid")) std::this_thread::sleep_for(milliseconds(5));
  const pid_t pid = std::stoi(ReadAll(folder_ / "pid"));
  ::kill(runner, SIGKILL);
  ::waitpid(runner, nullptr, 0);
  const bool has_ended = EndsSoon(pid);
  if (!has_ended) ::kill(pid, SIGKILL);
  EXPECT_TRUE(has_ended);
}

// ------------------------------------------------------------------------------- the installed executable

TEST(InstalledColmap, VersionAndOptions) {
  Reporter reporter;
  ColmapProgram program = ColmapProgram::Find("", reporter);
  ASSERT_GE(program.version().size(), 3u);
  EXPECT_TRUE(program.HasCommand("feature_extractor"));
  EXPECT_TRUE(program.HasCommand("mapper"));
  struct Case {
    const char* command;
    const char* option;
    const char* in_38;
  };
  for (const Case& c : {Case{"feature_extractor", "FeatureExtraction.use_gpu", "SiftExtraction.use_gpu"},
                        Case{"feature_extractor", "ImageReader.single_camera", "ImageReader.single_camera"},
                        Case{"exhaustive_matcher", "FeatureMatching.use_gpu", "SiftMatching.use_gpu"},
                        Case{"exhaustive_matcher", "TwoViewGeometry.max_error", "SiftMatching.max_error"},
                        Case{"mapper", "Mapper.ba_global_frames_freq", "Mapper.ba_global_images_freq"}}) {
    const auto spelling = program.SpellingOf(c.command, c.option, reporter);
    ASSERT_TRUE(spelling.has_value()) << c.option;
    if (program.version() == "3.8") {
      EXPECT_EQ(*spelling, c.in_38);
    }
  }
  EXPECT_FALSE(program.SpellingOf("mapper", "Mapper.no_such_option", reporter).has_value());
}

TEST(InstalledColmap, WritesADatabaseAndComplains) {
  TemporaryFolder folder;
  Recorder reporter;
  ColmapProgram program = ColmapProgram::Find("", reporter);
  const fs::path database = folder / "my database.db";
  program.Run({"database_creator", {{"database_path", database.string()}}, {{database}}}, reporter);
  EXPECT_TRUE(fs::exists(database));
  fs::create_directory(folder / "images");
  fs::create_directory(folder / "sparse");
  ExpectUserError(
      [&] {
        program.Run({"mapper",
                     {{"database_path", database.string()},
                      {"image_path", (folder / "images").string()},
                      {"output_path", (folder / "sparse").string()}},
                     {{folder / "sparse" / "0"}}},
                    reporter);
      },
      {"colmap mapper", "--database_path"});
}

}  // namespace
}  // namespace s2gs
