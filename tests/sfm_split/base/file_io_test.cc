#include "sfm_split/base/file_io.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sched.h>
#include <sys/mount.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <functional>
#include <string>
#include <thread>
#include <vector>

#include "sfm_split/base/error.h"
#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

void WriteText(const fs::path& path, const std::string& text) {
  WriteFileAtomically(path, [&](std::ostream& stream) { stream << text; });
}

std::vector<std::string> NamesIn(const fs::path& folder) {
  std::vector<std::string> names;
  for (const auto& entry : fs::directory_iterator(folder)) names.push_back(entry.path().filename().string());
  std::sort(names.begin(), names.end());
  return names;
}

// Runs `work` in a child process; returns the message of the UserError that it threw, or what else happened.
std::string MessageInChild(const std::function<void()>& work) {
  int ends[2];
  if (::pipe(ends) != 0) return "no pipe";
  const pid_t child = ::fork();
  if (child == 0) {
    std::string message = "no error";
    try {
      work();
    } catch (const UserError& error) {
      message = error.what();
    }
    if (::write(ends[1], message.data(), message.size()) < 0) ::_exit(1);
    ::_exit(0);
  }
  ::close(ends[1]);
  std::string message;
  char buffer[512];
  for (ssize_t count = 0; (count = ::read(ends[0], buffer, sizeof(buffer))) > 0;)
    message.append(buffer, count);
  ::close(ends[0]);
  int status = 0;
  ::waitpid(child, &status, 0);
  return WIFEXITED(status) && WEXITSTATUS(status) == 0 ? message : message + " (child crashed)";
}

TEST(WriteFileAtomically, WritesAndReplaces) {
  const TemporaryFolder folder;
  WriteText(folder / "a.txt", "first");
  EXPECT_EQ(ReadAll(folder / "a.txt"), "first");
  WriteText(folder / "a.txt", "");
  EXPECT_EQ(ReadAll(folder / "a.txt"), "");
  EXPECT_EQ(NamesIn(folder.path()), std::vector<std::string>{"a.txt"});
}

TEST(WriteFileAtomically, WritesEverySizeAroundItsBuffer) {
  const TemporaryFolder folder;
  for (const size_t size : {1UL, (1UL << 18) - 1, 1UL << 18, (1UL << 18) + 1, (3UL << 18) + 5}) {
    std::string content(size, '\0');
    for (size_t i = 0; i < size; ++i) content[i] = static_cast<char>(i * 31 + i / 257);
    // In one piece, in pieces of 1000 bytes, and byte by byte.
    for (const size_t piece : {size, size_t{1000}, size_t{1}}) {
      WriteFileAtomically(folder / "a", [&](std::ostream& stream) {
        for (size_t i = 0; i < size; i += piece) {
          if (piece == 1) {
            stream.put(content[i]);
          } else {
            stream.write(content.data() + i, static_cast<std::streamsize>(std::min(piece, size - i)));
          }
        }
      });
      EXPECT_TRUE(ReadAll(folder / "a") == content) << size << " bytes in pieces of " << piece;
    }
  }
}

TEST(WriteFileAtomically, CanSeekToFillInACount) {
  const TemporaryFolder folder;
  WriteFileAtomically(folder / "a", [](std::ostream& stream) {
    stream << "count=?;";
    const auto end = stream.tellp();
    EXPECT_EQ(end, std::streampos(8));
    stream.seekp(6);
    stream << '3';
    stream.seekp(end);
    stream << "abc";
  });
  EXPECT_EQ(ReadAll(folder / "a"), "count=3;abc");
}

TEST(WriteFileAtomically, KeepsTheOldFileWhenTheWriterThrows) {
  const TemporaryFolder folder;
  WriteText(folder / "a", "old");
  EXPECT_THROW(WriteFileAtomically(folder / "a",
                                   [](std::ostream& stream) {
                                     stream << "half of the new" << std::flush;
                                     throw std::runtime_error("stopped");
                                   }),
               std::runtime_error);
  EXPECT_EQ(ReadAll(folder / "a"), "old");
  EXPECT_EQ(NamesIn(folder.path()), std::vector<std::string>{"a"});
}

TEST(WriteFileAtomically, RefusesAStreamThatTheWriterLeftFailed) {
  const TemporaryFolder folder;
  WriteText(folder / "a", "old");
  ExpectUserError(
      [&] { WriteFileAtomically(folder / "a", [](std::ostream& s) { s.setstate(std::ios::failbit); }); },
      {(folder / "a").string(), "completely"});
  EXPECT_EQ(ReadAll(folder / "a"), "old");
}

TEST(WriteFileAtomically, NamesThePathAndTheReason) {
  const TemporaryFolder folder;
  const std::string missing = (folder / "missing/a").string();
  ExpectUserError([&] { WriteText(missing, "x"); }, {missing, "No such file or directory", "folder exists"});
  ExpectUserError([&] { WriteText(folder.path(), "x"); }, {folder.path().string(), "is a folder"});
  ExpectUserError([&] { WriteText(folder.path().string() + "/", "x"); }, {"is not a file's name"});
  ExpectUserError([&] { WriteText("", "x"); }, {"is not a file's name"});
}

TEST(WriteFileAtomically, NeverReplacesDevices) {
  struct stat before = {};
  ASSERT_EQ(::stat("/dev/null", &before), 0);
  ExpectUserError([] { WriteText("/dev/null", "x"); }, {"/dev/null", "device or pipe"});
  struct stat after = {};
  ASSERT_EQ(::stat("/dev/null", &after), 0);
  EXPECT_EQ(before.st_ino, after.st_ino);
}

TEST(WriteFileAtomically, KeepsLinksAndPermissions) {
  const TemporaryFolder folder;
  WriteAll(folder / "disk/real.db", "old");
  ASSERT_EQ(::chmod((folder / "disk/real.db").c_str(), 0640), 0);
  fs::create_symlink("disk/real.db", folder / "link.db");
  WriteText(folder / "link.db", "new");
  EXPECT_TRUE(fs::is_symlink(folder / "link.db"));
  EXPECT_EQ(ReadAll(folder / "disk/real.db"), "new");
  struct stat status = {};
  ASSERT_EQ(::stat((folder / "disk/real.db").c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 07777, 0640U);
}

TEST(WriteFileAtomically, DoesNotFollowALinkUnderItsTemporaryName) {
  const TemporaryFolder folder;
  folder.Write("other", "untouched");
  fs::path temporary;
  WriteFileAtomicallyByPath(folder / "a", [&](const fs::path& path) {
    temporary = path;
    WriteAll(path, "x");
  });
  // The next temporary of this process has the next number.
  const std::string name = temporary.filename().string();
  const size_t begin = name.find('-', std::string(".s2gs-tmp-").size()) + 1;
  const int next = std::stoi(name.substr(begin)) + 1;
  fs::create_symlink("other", folder / (name.substr(0, begin) + std::to_string(next) + "-a"));
  WriteText(folder / "a", "new");
  EXPECT_EQ(folder.Read("a"), "new");
  EXPECT_EQ(folder.Read("other"), "untouched");
  EXPECT_FALSE(fs::is_symlink(folder / "a"));
}

TEST(WriteFileAtomically, TakesTheLongestNames) {
  const TemporaryFolder folder;
  const std::string name = std::string(251, 'n') + ".ply";
  WriteText(folder / name, "x");
  EXPECT_EQ(ReadAll(folder / name), "x");
  ExpectUserError([&] { WriteText(folder / (name + "y"), "x"); }, {"too long"});
}

TEST(WriteFileAtomically, KeepsThreadsApart) {
  const TemporaryFolder folder;
  const fs::path path = folder / "same";
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&path, t] {
      for (int i = 0; i < 20; ++i) WriteText(path, std::string(10000 + t, static_cast<char>('a' + t)));
    });
  }
  for (std::thread& thread : threads) thread.join();
  const std::string content = ReadAll(path);
  ASSERT_FALSE(content.empty());
  const int writer = content[0] - 'a';
  EXPECT_TRUE(content == std::string(10000 + writer, content[0]));
}

TEST(WriteFileAtomically, FullDiskKeepsTheOldFile) {
  const TemporaryFolder folder;
  const fs::path disk = folder / "disk";
  fs::create_directory(disk);
  int64_t num_written = 0;
  const std::string message = MessageInChild([&] {
    // A file system of its own, which vanishes with the child.
    if (::unshare(CLONE_NEWNS) != 0 || ::mount(nullptr, "/", nullptr, MS_REC | MS_PRIVATE, nullptr) != 0 ||
        ::mount("none", disk.c_str(), "tmpfs", 0, "size=1m") != 0) {
      throw UserError("cannot mount");
    }
    WriteText(disk / "a", "old");
    std::string outcome;
    try {
      WriteFileAtomically(disk / "a", [&](std::ostream& stream) {
        const std::string chunk(1 << 16, 'x');
        for (; num_written < 1024; ++num_written)
          stream.write(chunk.data(), static_cast<std::streamsize>(chunk.size()));
      });
    } catch (const UserError& error) {
      outcome = error.what();
    }
    throw UserError(outcome + " | " + ReadAll(disk / "a") + " | " + std::to_string(NamesIn(disk).size()) +
                    " file | " + (num_written < 32 ? "stopped early" : "formatted to the end"));
  });
  if (message == "cannot mount") GTEST_SKIP() << "mounting needs root";
  EXPECT_THAT(message,
              HasSubstr((disk / "a").string() +
                        ": cannot be written completely (No space left on device). Free some space"));
  EXPECT_THAT(message, HasSubstr("| old | 1 file | stopped early"));
}

TEST(WriteFileAtomically, FileSizeLimitKeepsTheOldFile) {
  const TemporaryFolder folder;
  const fs::path path = folder / "a";
  WriteText(path, "old");
  const std::string message = MessageInChild([&] {
    ::signal(SIGXFSZ, SIG_IGN);
    const struct rlimit limit = {1 << 20, 1 << 20};
    ::setrlimit(RLIMIT_FSIZE, &limit);
    WriteText(path, std::string(2 << 20, 'x'));
  });
  EXPECT_THAT(message, HasSubstr(path.string() + ": cannot be written completely (File too large)"));
  EXPECT_THAT(message, HasSubstr("ulimit -f"));
  EXPECT_EQ(ReadAll(path), "old");
  EXPECT_EQ(NamesIn(folder.path()).size(), 1U);
}

TEST(WriteFilesTogether, FileSizeLimitKeepsAllOldFiles) {
  const TemporaryFolder folder;
  for (const std::string name : {"a", "b", "obsolete"}) folder.Write(name, "old");
  const std::string message = MessageInChild([&] {
    ::signal(SIGXFSZ, SIG_IGN);
    const struct rlimit limit = {1 << 20, 1 << 20};
    ::setrlimit(RLIMIT_FSIZE, &limit);
    WriteFilesTogether({{folder / "a", [](std::ostream& stream) { stream << "new"; }},
                        {folder / "b", [](std::ostream& stream) { stream << std::string(2 << 20, 'x'); }}},
                       {folder / "obsolete"});
  });
  EXPECT_THAT(message,
              HasSubstr((folder / "b").string() + ": cannot be written completely (File too large)"));
  EXPECT_THAT(NamesIn(folder.path()), ::testing::ElementsAre("a", "b", "obsolete"));
  for (const std::string name : {"a", "b", "obsolete"}) EXPECT_EQ(folder.Read(name), "old");
}

TEST(WriteFileAtomicallyByPath, KeepsTheExtensionAndTheFolder) {
  const TemporaryFolder folder;
  WriteFileAtomicallyByPath(folder / "mesh.ply", [&](const fs::path& temporary) {
    EXPECT_EQ(temporary.extension(), ".ply");
    EXPECT_EQ(temporary.parent_path(), folder.path());
    EXPECT_TRUE(IsTemporaryName(temporary.filename().string()));
    WriteAll(temporary, "by another library");
  });
  EXPECT_EQ(ReadAll(folder / "mesh.ply"), "by another library");
  ExpectUserError([&] { WriteFileAtomicallyByPath(folder / "b", [](const fs::path&) {}); },
                  {(folder / "b").string()});
}

TEST(RemoveStaleTemporaries, RemovesThoseOfDeadProcessesOnly) {
  const TemporaryFolder folder;
  const pid_t child = ::fork();
  if (child == 0) ::_exit(0);
  ASSERT_EQ(::waitpid(child, nullptr, 0), child);
  const std::string mark = ".s2gs-tmp-";
  const std::vector<std::string> kept = {"a.ply",
                                         mark + "1-1-init-runs.ply",
                                         mark,
                                         mark + "x-a",
                                         mark + "-5-a",
                                         mark + "0-a",
                                         mark + "99999999999999999999-a",
                                         mark + std::to_string(child)};
  for (const std::string& name : kept) WriteAll(folder / name, "x");
  for (const pid_t pid : {child, ::getpid()})
    WriteAll(folder / (mark + std::to_string(pid) + "-3-a.ply"), "x");
  WriteAll(folder / ("below/" + mark + std::to_string(child) + "-1-a"), "x");
  RemoveStaleTemporaries(folder.path());
  std::vector<std::string> expected = kept;
  expected.emplace_back("below");
  EXPECT_THAT(NamesIn(folder.path()), ::testing::UnorderedElementsAreArray(expected));
  EXPECT_EQ(NamesIn(folder / "below").size(), 1U);
  EXPECT_NO_THROW(RemoveStaleTemporaries(folder / "missing"));
}

TEST(OpenForReading, RefusesWhatIsNoFile) {
  const TemporaryFolder folder;
  ExpectUserError([&] { OpenForReading(folder / "a", "Run `x` first"); }, {"no such file", "Run `x` first"});
  ExpectUserError([&] { OpenForReading(folder.path()); }, {"is a folder"});
  // Opening it would wait for a writer.
  ASSERT_EQ(::mkfifo((folder / "pipe").c_str(), 0600), 0);
  ExpectUserError([&] { OpenForReading(folder / "pipe"); }, {"device or pipe"});
  ExpectUserError([] { OpenForReading("/dev/zero"); }, {"device or pipe"});
  WriteAll(folder / "good", "content");
  std::string word;
  OpenForReading(folder / "good") >> word;
  EXPECT_EQ(word, "content");
}

TEST(OpenForReading, NamesMissingPermission) {
  const TemporaryFolder folder;
  WriteAll(folder / "secret", "x");
  ASSERT_EQ(::chmod(folder.path().c_str(), 0755), 0);
  ASSERT_EQ(::chmod((folder / "secret").c_str(), 0), 0);
  const std::string message = MessageInChild([&] {
    constexpr uid_t kNobody = 65534;
    if (::getuid() == 0 && ::setuid(kNobody) != 0) throw UserError("cannot be nobody");
    OpenForReading(folder / "secret", "Run `x` first");
  });
  EXPECT_THAT(message, HasSubstr("secret: cannot be read (Permission denied)"));
}

TEST(ReadWholeFile, ReadsUpToTheLimit) {
  const TemporaryFolder folder;
  const std::string content("a\0b\n", 4);
  WriteAll(folder / "a", content);
  EXPECT_EQ(ReadWholeFile(folder / "a", 4), content);
  const ScopedAllocationLimit limit(1 << 16);
  ExpectUserError([&] { ReadWholeFile(folder / "a", 3); }, {(folder / "a").string(), "4 bytes", "3"});
  // As long as it likes, without being that long on the disk.
  WriteAll(folder / "huge", "");
  fs::resize_file(folder / "huge", uint64_t{1} << 40);
  ExpectUserError([&] { ReadWholeFile(folder / "huge", 1 << 20); }, {"1099511627776 bytes"});
}

TEST(CreateFolder, CreatesParentsAndNamesWhatIsInTheWay) {
  const TemporaryFolder folder;
  CreateFolder(folder / "a/b/c");
  EXPECT_TRUE(fs::is_directory(folder / "a/b/c"));
  EXPECT_NO_THROW(CreateFolder(folder / "a/b/c"));
  WriteAll(folder / "file", "x");
  ExpectUserError([&] { CreateFolder(folder / "file"); }, {(folder / "file").string(), "cannot be created"});
  ExpectUserError([&] { CreateFolder(folder / "file/below"); }, {(folder / "file/below").string()});
  ExpectUserError([] { CreateFolder(""); }, {"cannot be created"});
}

TEST(SyncToDisk, TakesFilesAndFolders) {
  const TemporaryFolder folder;
  WriteAll(folder / "a/b/c", "x");
  EXPECT_NO_THROW(SyncToDisk(folder.path()));
  EXPECT_NO_THROW(SyncToDisk(folder / "a/b/c"));
  ExpectUserError([&] { SyncToDisk(folder / "missing"); }, {"missing"});
}

}  // namespace
}  // namespace s2gs
