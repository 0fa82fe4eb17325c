#include <gtest/gtest.h>

#include <stdexcept>

#include "sfm_split/base/file_io.h"
#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

size_t NumFiles(const std::filesystem::path& folder) {
  size_t count = 0;
  for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(folder)) ++count;
  return count;
}

TEST(WriteFilesTogether, ReplacesAllAndRemovesTheObsolete) {
  const TemporaryFolder folder;
  folder.Write("a", "old");
  folder.Write("stale", "old");
  WriteFilesTogether({{folder / "a", [](std::ostream& stream) { stream << "A"; }},
                      {folder / "b", [](std::ostream& stream) { stream << "B"; }}},
                     {folder / "stale", folder / "never there"});
  EXPECT_EQ(folder.Read("a"), "A");
  EXPECT_EQ(folder.Read("b"), "B");
  EXPECT_EQ(NumFiles(folder.path()), 2u);
}

TEST(WriteFilesTogether, ChangesNothingWhenOneFails) {
  const TemporaryFolder folder;
  folder.Write("a", "old");
  folder.Write("stale", "old");
  const auto fail = [](std::ostream& stream) {
    stream << "half";
    throw std::runtime_error("no more");
  };
  EXPECT_THROW(
      WriteFilesTogether({{folder / "a", [](std::ostream& stream) { stream << "A"; }}, {folder / "b", fail}},
                         {folder / "stale"}),
      std::runtime_error);
  EXPECT_EQ(folder.Read("a"), "old");
  EXPECT_EQ(folder.Read("stale"), "old");
  EXPECT_EQ(NumFiles(folder.path()), 2u);
  ExpectUserError(
      [&] {
        WriteFilesTogether({{folder / "none/a", [](std::ostream& stream) { stream << "A"; }}});
      },
      {(folder / "none/a").string()});
}

}  // namespace
}  // namespace s2gs
