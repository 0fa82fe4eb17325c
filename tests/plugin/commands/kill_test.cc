// Kills a process that writes into a workspace, with SIGKILL at random moments, and looks at what it left.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <iterator>
#include <map>
#include <random>
#include <string>
#include <vector>

#include "plugin/stage/stage.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "tests/plugin/commands/subprocess.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr int kNumKills = 100;

// Any byte of it tells which version it is of; sizes go from 8 bytes to a few buffers.
std::string Content(uint64_t version) {
  constexpr size_t kSizes[] = {8, 100, 5'000, 70'000, 262'144, 700'001};
  std::string content(kSizes[version % std::size(kSizes)], static_cast<char>('A' + version % 26));
  for (int i = 0; i < 8; ++i) content[i] = static_cast<char>(version >> (8 * i));
  return content;
}

// The version of a file; fails the test unless the file is entirely that version.
uint64_t VersionOf(const fs::path& path) {
  const std::string content = ReadAll(path);
  uint64_t version = 0;
  for (size_t i = 0; i < 8 && i < content.size(); ++i)
    version |= uint64_t{static_cast<unsigned char>(content[i])} << (8 * i);
  EXPECT_TRUE(content == Content(version))
      << path << " is broken: " << content.size() << " bytes, version " << version;
  return version;
}

int CountTemporaries(const fs::path& folder) {
  int count = 0;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    if (IsTemporaryName(entry.path().filename().string())) ++count;
  }
  return count;
}

void Write(const fs::path& path, const std::string& content) {
  // In pieces, so that a kill can fall between them.
  WriteFileAtomically(path, [&](std::ostream& stream) {
    for (size_t i = 0; i < content.size(); i += 10'000) {
      stream.write(content.data() + i,
                   static_cast<std::streamsize>(std::min<size_t>(10'000, content.size() - i)));
      stream.flush();
    }
  });
}

// Kills a child after a random number of its ready calls (0 to `max_calls`) and a random while, or when it
// has ended.
class Killer {
 public:
  int KillAtRandomMoment(ChildProcess* child, int max_calls) {
    bool is_running = true;
    for (int i = Random(max_calls); is_running && i > 0; --i) is_running = child->WaitUntilReady();
    // 1 to 1000 us, as often within 1 to 10 as within 100 to 1000: writes take as long as the disk wants.
    const double delay_us = std::pow(10.0, std::uniform_real_distribution<double>(0, 3)(random_));
    if (is_running) ::usleep(static_cast<useconds_t>(delay_us));
    child->Signal(SIGKILL);
    return child->Wait();
  }

 private:
  int Random(int max) { return std::uniform_int_distribution<int>(0, max)(random_); }
  std::mt19937 random_{20240607};
};

TEST(Kill, FilesAreEntirelyOldOrEntirelyNew) {
  const TemporaryFolder folder;
  const std::vector<fs::path> files = {folder / "turntable.json", folder / "sparse/0/images.bin",
                                       folder / "s2gs/point_cloud.ply"};
  std::map<fs::path, uint64_t> version;
  for (const fs::path& path : files) WriteAll(path, Content(0));
  Killer killer;
  int num_leftovers = 0;
  uint64_t num_writes = 0;
  for (int kill = 0; kill < kNumKills; ++kill) {
    {
      ChildProcess child([&](const std::function<void()>& say_ready) {
        for (uint64_t step = 1;; ++step) {
          for (const fs::path& path : files) {
            Write(path, Content(version[path] + step));
            say_ready();
          }
        }
        return 0;
      });
      ASSERT_EQ(killer.KillAtRandomMoment(&child, 10), 128 + SIGKILL);
    }
    std::vector<uint64_t> steps;
    for (const fs::path& path : files) {
      const uint64_t now = VersionOf(path);
      ASSERT_FALSE(::testing::Test::HasFailure()) << "kill " << kill;
      // Never back to something older than what was complete.
      ASSERT_GE(now, version[path]);
      steps.push_back(now - version[path]);
      num_writes += now - version[path];
      version[path] = now;
    }
    // The files were written in order, so the earlier are at most one step ahead of the later.
    EXPECT_TRUE(std::is_sorted(steps.rbegin(), steps.rend()));
    EXPECT_LE(steps.front() - steps.back(), 1U);
    num_leftovers += CountTemporaries(folder.path());
    RemoveStaleWorkspaceTemporaries({folder.path()});
    EXPECT_EQ(CountTemporaries(folder.path()), 0);
  }
  // The kills did fall into writes: without leftovers this test would have shown nothing.
  EXPECT_GT(num_leftovers, kNumKills / 10);
  EXPECT_GT(num_writes, 0U);
  std::printf("%d kills, %llu finished writes, %d temporary files left and cleaned\n", kNumKills,
              static_cast<unsigned long long>(num_writes), num_leftovers);
}

std::vector<Stage> Stages(const Workspace& w, const std::string& round) {
  return {{"split", {w.Images()}, {{"round", round}}, {w.ObjectDatabase(), w.StaticDatabase()}, {}},
          {"map", {w.ObjectDatabase()}, {{"round", round}}, {w.ObjectModel(), w.Turntable()}, {"split"}},
          {"mesh", {w.ObjectModel()}, {{"round", round}}, {w.TsdfMesh()}, {"map"}}};
}

fs::path FileOf(const Workspace& workspace, const fs::path& output) {
  return output == workspace.ObjectModel() ? output / "images.bin" : output;
}

std::string StageOutput(const std::string& stage, const std::string& round) {
  return stage + " " + round + " " + std::string(20'000 + 100 * round.size(), round.back());
}

// Returns how many stages ran.
int RunStages(const Workspace& workspace, const std::string& round,
              const std::function<void()>& after_each_file) {
  Reporter silent;
  StageRunner runner(workspace, silent);
  int num_run = 0;
  for (const Stage& stage : Stages(workspace, round)) {
    const bool did_run = runner.Run(stage, [&] {
      for (const fs::path& output : stage.outputs) {
        const fs::path file = FileOf(workspace, output);
        CreateFolder(file.parent_path());
        Write(file, StageOutput(stage.name, round));
        after_each_file();
      }
    });
    num_run += did_run ? 1 : 0;
    after_each_file();
  }
  return num_run;
}

void ExpectOutputs(const Workspace& workspace, const Stage& stage, const std::string& round) {
  for (const fs::path& output : stage.outputs) {
    EXPECT_TRUE(ReadAll(FileOf(workspace, output)) == StageOutput(stage.name, round))
        << output << " of round " << round;
  }
}

TEST(Kill, StagesResumeWhereTheyStopped) {
  const TemporaryFolder folder;
  const Workspace workspace{folder.path()};
  WriteAll(folder / "images/a.jpg", "photo");
  Killer killer;
  std::vector<int> num_kills(4);  // by the number of stages done
  for (int kill = 0; kill < kNumKills; ++kill) {
    const std::string round = std::to_string(kill);
    {
      ChildProcess child([&](const std::function<void()>& say_ready) {
        RunStages(workspace, round, say_ready);
        return 0;
      });
      ASSERT_THAT(killer.KillAtRandomMoment(&child, 7), ::testing::AnyOf(0, 128 + SIGKILL));
    }
    // A stage that is stamped with this round has all of its outputs.
    Reporter silent;
    int num_done = 0;
    for (const Stage& stage : Stages(workspace, round)) {
      const auto stamp = ReadStageStamp(workspace, stage.name, silent);
      if (!stamp.has_value() || stamp->options.at("round") != round) break;
      ++num_done;
      ExpectOutputs(workspace, stage, round);
    }
    ++num_kills[num_done];
    // The same command finishes the work, and does not repeat what was done.
    EXPECT_EQ(RunStages(workspace, round, [] {}), 3 - num_done);
    for (const Stage& stage : Stages(workspace, round)) ExpectOutputs(workspace, stage, round);
    EXPECT_EQ(RunStages(workspace, round, [] {}), 0);
    EXPECT_EQ(CountTemporaries(folder.path()), 0);
    ASSERT_FALSE(::testing::Test::HasFailure()) << "after kill " << kill;
  }
  // Kills fell before the first stage was done and between stages.
  for (int num_done = 0; num_done < 3; ++num_done) EXPECT_GT(num_kills[num_done], 0) << num_done;
  std::printf("%d kills: %d, %d, %d, %d with 0, 1, 2, 3 of 3 stages done\n", kNumKills, num_kills[0],
              num_kills[1], num_kills[2], num_kills[3]);
}

}  // namespace
}  // namespace s2gs
