#include "sfm_split/base/resolved_path.h"

#include <gtest/gtest.h>

#include <filesystem>

#include "sfm_split/base/file_io.h"
#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

TEST(ResolvedPath, IsWithinByItsParts) {
  EXPECT_TRUE(IsWithin("/a/b", "/a/b"));
  EXPECT_TRUE(IsWithin("/a/b/c", "/a/b"));
  EXPECT_FALSE(IsWithin("/a/bc", "/a/b"));
  EXPECT_FALSE(IsWithin("/a", "/a/b"));
}

TEST(ResolvedPath, FollowsLinksAsFarAsTheyExist) {
  const TemporaryFolder folder;
  CreateFolder(folder / "real");
  fs::create_directory_symlink("real", folder / "link");
  const fs::path real = fs::canonical(folder.path()) / "real";
  EXPECT_EQ(ResolvedPath(folder / "link"), real);
  EXPECT_EQ(ResolvedPath(folder / "link/"), real);
  EXPECT_EQ(ResolvedPath(folder / "link/new/../x"), real / "x");
  fs::create_directory_symlink("loop", folder / "loop");
  ExpectUserError([&] { ResolvedPath(folder / "loop/a"); }, {"loop", "links"});
}

class LinkOut : public ::testing::Test {
 protected:
  LinkOut() {
    CreateFolder(root_ / "sparse/0");
    CreateFolder(outside_);
  }
  TemporaryFolder folder_;
  fs::path root_ = folder_ / "scan";
  fs::path outside_ = folder_ / "outside";
};

TEST_F(LinkOut, NothingWithoutLinks) {
  EXPECT_FALSE(FindLinkOut(root_, root_ / "sparse"));
  EXPECT_FALSE(FindLinkOut(root_, root_ / "not/there"));
  EXPECT_NO_THROW(RequireNoLinkOut(root_, root_ / "sparse/0"));
}

TEST_F(LinkOut, OnTheWayAtItAndBelowIt) {
  fs::create_directory_symlink(outside_, root_ / "split");
  fs::create_symlink(outside_ / "a.bin", root_ / "sparse/0/images.bin");  // which does not exist
  EXPECT_EQ(FindLinkOut(root_, root_ / "split/object.db"), root_ / "split");
  EXPECT_EQ(FindLinkOut(root_, root_ / "split"), root_ / "split");
  EXPECT_EQ(FindLinkOut(root_, root_ / "sparse"), root_ / "sparse/0/images.bin");
  EXPECT_FALSE(FindLinkOut(root_, root_ / "sparse/static"));
  ExpectUserError([&] { RequireNoLinkOut(root_, root_ / "split/labels.json"); },
                  {"scan/split", outside_.string(), "nothing is written", "symbolic link"});
}

TEST_F(LinkOut, AFileOfTheWorkspaceIsNotReplacedThroughAnother) {
  folder_.Write("scan/images/a.jpg", "photo");
  fs::create_symlink("images/a.jpg", root_ / "report.html");
  EXPECT_EQ(FindLinkOut(root_, root_ / "report.html"), root_ / "report.html");
  ExpectUserError([&] { RequireNoLinkOut(root_, root_ / "report.html"); },
                  {"scan/report.html", "images/a.jpg, another file", "nothing is written", "symbolic link"});
}

TEST_F(LinkOut, FoldersWithinTheWorkspaceAreFine) {
  fs::create_directory_symlink("sparse", root_ / "models");
  fs::create_directory_symlink(root_ / "sparse/0", root_ / "sparse/again");
  EXPECT_FALSE(FindLinkOut(root_, root_ / "models/0"));
  EXPECT_FALSE(FindLinkOut(root_, root_ / "sparse"));
}

TEST_F(LinkOut, TheWorkspaceMayBeALinkItself) {
  fs::create_directory_symlink(root_, folder_ / "link");
  EXPECT_FALSE(FindLinkOut(folder_ / "link", folder_ / "link/sparse"));
  fs::create_directory_symlink(outside_, root_ / "split");
  EXPECT_EQ(FindLinkOut(folder_ / "link", folder_ / "link/split"), folder_ / "link/split");
}

TEST_F(LinkOut, APathElsewhereWasGivenAsItIs) {
  fs::create_directory_symlink(outside_, folder_ / "link");
  EXPECT_FALSE(FindLinkOut(root_, folder_ / "link/mesh.ply"));
}

}  // namespace
}  // namespace s2gs
