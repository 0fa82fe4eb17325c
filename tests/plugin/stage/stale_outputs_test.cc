#include "plugin/stage/stale_outputs.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <string>

#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

class Recorder : public Reporter {
 public:
  void Log(LogLevel level, std::string_view message) override {
    if (level >= LogLevel::kInfo) said += std::string(message) + "\n";
  }
  std::string said;
};

class StaleOutputs : public testing::Test {
 protected:
  void Render(const std::set<std::string>& names) {
    for (const std::string& name : names) {
      for (const fs::path& path : FilesOf(name)) WriteAll(path, "rendered");
    }
    reporter_.said.clear();
    TidyImageOutputs(workspace_, folder_ / "photos", names, reporter_);
  }
  std::vector<fs::path> FilesOf(const std::string& name) const {
    return {workspace_.Mask(name), workspace_.DenseMasks() / (name + ".png"), workspace_.DenseImages() / name,
            workspace_.DepthMap(name), workspace_.NormalMap(name)};
  }

  TemporaryFolder folder_;
  Workspace workspace_{folder_ / "scan"};
  Recorder reporter_;
  void SetUp() override { fs::create_directories(workspace_.Own()); }
};

TEST_F(StaleOutputs, OwnFilesOfPhotosThatAreGoneAreRemoved) {
  Render({"a.jpg", "sub/b.jpg"});
  Render({"a.jpg"});
  for (const fs::path& path : FilesOf("a.jpg")) EXPECT_TRUE(fs::exists(path)) << path;
  for (const fs::path& path : FilesOf("sub/b.jpg")) EXPECT_FALSE(fs::exists(path)) << path;
  EXPECT_THAT(reporter_.said,
              testing::HasSubstr("removed 5 files of 1 photos that are no longer there, sub/b.jpg"));
  Render({"a.jpg"});
  EXPECT_EQ(reporter_.said, "");
}

TEST_F(StaleOutputs, WhatIsNotOursIsNamedAndStays) {
  WriteAll(workspace_.Mask("mine.jpg"), "by hand");
  Render({"a.jpg", "b.jpg"});
  EXPECT_THAT(reporter_.said, testing::HasSubstr("1 files belong to none of the photos"));
  // Changed after it was rendered.
  fs::last_write_time(workspace_.Mask("b.jpg"), fs::file_time_type::clock::now() + std::chrono::hours(1));
  Render({"a.jpg"});
  EXPECT_TRUE(fs::exists(workspace_.Mask("mine.jpg")));
  EXPECT_TRUE(fs::exists(workspace_.Mask("b.jpg")));
  EXPECT_FALSE(fs::exists(workspace_.DepthMap("b.jpg")));
}

TEST_F(StaleOutputs, AHostileListRemovesNothingElsewhere) {
  WriteAll(folder_ / "photos/a.jpg", "photo");
  WriteAll(folder_ / "outside/x.jpg.png", "other");
  WriteAll(workspace_.Own() / "rendered.txt",
           "../../photos/a.jpg\n" + (folder_ / "photos/a.jpg").string() + "\nx.jpg\n");
  fs::create_directory_symlink(folder_ / "outside", workspace_.Masks());
  TidyImageOutputs(workspace_, folder_ / "photos", {"a.jpg"}, reporter_);
  EXPECT_TRUE(fs::exists(folder_ / "photos/a.jpg"));
  EXPECT_TRUE(fs::exists(folder_ / "outside/x.jpg.png"));
}

}  // namespace
}  // namespace s2gs
