#include "plugin/stage/fingerprint.h"

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <string>

#include "sfm_split/base/error.h"
#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

class Stopped : public Reporter {
 public:
  bool StopRequested() const override { return true; }
};

const Reporter kSilent;

TEST(Fingerprint, CountsFilesAndBytes) {
  const TemporaryFolder folder;
  WriteAll(folder / "a", "12345");
  WriteAll(folder / "sub/b", "123");
  EXPECT_EQ(TakeState(folder / "a").num_bytes, 5U);
  EXPECT_EQ(TakeState(folder / "a").num_files, 1U);
  const Fingerprint all = TakeState(folder.path());
  EXPECT_TRUE(all.exists);
  EXPECT_EQ(all.num_files, 2U);
  EXPECT_EQ(all.num_bytes, 8U);
  EXPECT_TRUE(all.content.empty());
  EXPECT_FALSE(TakeState(folder / "missing").exists);
}

TEST(Fingerprint, ContentsTellChangesOfEqualSize) {
  const TemporaryFolder folder;
  for (const std::string name : {"a", "sub/a"}) {
    WriteAll(folder / name, "12345");
    const fs::path path = folder / name.substr(0, name.find('/'));
    const std::string before = TakeFingerprint(path, kSilent).content;
    WriteAll(folder / name, "12346");
    EXPECT_NE(TakeFingerprint(path, kSilent).content, before) << name;
    WriteAll(folder / name, "12345");
    EXPECT_EQ(TakeFingerprint(path, kSilent).content, before) << name;
    fs::remove_all(path);
  }
}

TEST(Fingerprint, FoldersKnowTheirNames) {
  const TemporaryFolder folder;
  WriteAll(folder / "f/a", "1");
  WriteAll(folder / "f/b", "2");
  const std::string before = TakeFingerprint(folder / "f", kSilent).content;
  fs::rename(folder / "f/b", folder / "f/c");
  EXPECT_NE(TakeFingerprint(folder / "f", kSilent).content, before);
  fs::rename(folder / "f/c", folder / "f/b");
  EXPECT_EQ(TakeFingerprint(folder / "f", kSilent).content, before);
  // The same bytes split differently.
  WriteAll(folder / "f/a", "12");
  WriteAll(folder / "f/b", "");
  EXPECT_NE(TakeFingerprint(folder / "f", kSilent).content, before);
}

TEST(Fingerprint, HiddenFilesDoNotCount) {
  const TemporaryFolder folder;
  WriteAll(folder / "a", "1");
  const std::string before = TakeFingerprint(folder.path(), kSilent).content;
  WriteAll(folder / ".DS_Store", "x");
  WriteAll(folder / ".thumbs/a", "x");
  EXPECT_EQ(TakeFingerprint(folder.path(), kSilent).content, before);
  EXPECT_EQ(TakeState(folder.path()).num_files, 1U);
}

TEST(Fingerprint, PipesAndDanglingLinksAreNotRead) {
  const TemporaryFolder folder;
  WriteAll(folder / "a", "1");
  ASSERT_EQ(::mkfifo((folder / "pipe").c_str(), 0600), 0);
  fs::create_symlink("nowhere", folder / "link");
  fs::create_directory_symlink(".", folder / "loop");
  EXPECT_EQ(TakeFingerprint(folder.path(), kSilent).num_files, 1U);
}

TEST(Fingerprint, StatesOfFreshFilesProveNothing) {
  const TemporaryFolder folder;
  WriteAll(folder / "a", "1");
  EXPECT_TRUE(TakeState(folder / "a").state.empty());
}

// A fingerprint whose state proves something: waits until the file is old enough.
Fingerprint Settled(const fs::path& path) {
  Fingerprint print = TakeFingerprint(path, kSilent);
  while (print.state.empty()) {
    ::usleep(50'000);
    print.state = TakeState(path).state;
  }
  return print;
}

TEST(Fingerprint, UnchangedFilesAreNotRead) {
  const TemporaryFolder folder;
  WriteAll(folder / "a", "1");
  Fingerprint known = Settled(folder / "a");
  known.content = "as before";
  EXPECT_EQ(RefreshFingerprint(folder / "a", known, kSilent).content, "as before");
  // Another state makes it read again.
  fs::last_write_time(folder / "a", fs::file_time_type::clock::now() - std::chrono::hours(1));
  const Fingerprint now = RefreshFingerprint(folder / "a", known, kSilent);
  EXPECT_EQ(now.content, TakeFingerprint(folder / "a", kSilent).content);
}

TEST(Fingerprint, CanBeStopped) {
  const TemporaryFolder folder;
  WriteAll(folder / "a", "1");
  EXPECT_THROW(TakeFingerprint(folder / "a", Stopped()), Interrupted);
}

}  // namespace
}  // namespace s2gs
