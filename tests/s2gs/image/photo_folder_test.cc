#include "s2gs/image/photo_folder.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <string>
#include <vector>

#include "sfm_split/base/error.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

class PhotoFolderTest : public testing::Test {
 protected:
  void Add(const std::string& name, int width = 40, int height = 30) const {
    fs::create_directories((folder_ / name).parent_path());
    Image8 image{width, height, 3, std::vector<uint8_t>(static_cast<size_t>(width) * height * 3)};
    // Noise, so that files are as long as those of photos.
    for (size_t i = 0; i < image.pixels.size(); ++i)
      image.pixels[i] = static_cast<uint8_t>(i * 2654435761U >> 13U);
    WriteImage(folder_ / name, image);
  }
  PhotoFolder Inspect() const { return InspectPhotoFolder(folder_.path()); }
  std::vector<std::string> Names() const {
    std::vector<std::string> names;
    for (const PhotoFile& photo : Inspect().photos) names.push_back(photo.name);
    return names;
  }

  TemporaryFolder folder_;
};

TEST_F(PhotoFolderTest, SoundPhotos) {
  Add("b.jpg");
  Add("sub/a.PNG", 64, 48);
  Add("a.jpeg");
  const PhotoFolder folder = Inspect();
  EXPECT_THAT(folder.faults, IsEmpty());
  EXPECT_THAT(folder.notes, IsEmpty());
  EXPECT_FALSE(folder.has_other_files);
  EXPECT_THAT(Names(), ElementsAre("a.jpeg", "b.jpg", "sub/a.PNG"));
  EXPECT_EQ(folder.photos[2].size.width, 64);
  EXPECT_EQ(folder.photos[2].size.height, 48);
  EXPECT_EQ(folder.photos[2].num_bytes, fs::file_size(folder_ / "sub/a.PNG"));
  EXPECT_THROW(InspectPhotoFolder(folder_ / "none"), UserError);
}

TEST_F(PhotoFolderTest, HiddenAndOtherFilesAreLeftAlone) {
  Add("a.jpg");
  for (const char* name : {"._a.jpg", ".DS_Store", "notes.txt", ".hidden/b.jpg", "a.CR2", "A.heic"}) {
    folder_.Write(name, "x");
  }
  const PhotoFolder folder = Inspect();
  EXPECT_THAT(folder.faults, IsEmpty());
  EXPECT_THAT(folder.notes, ElementsAre(HasSubstr("1 hidden files"), HasSubstr("2 files of other formats")));
  EXPECT_TRUE(folder.has_other_files);
  EXPECT_THAT(Names(), ElementsAre("a.jpg"));
}

TEST_F(PhotoFolderTest, WhatHasToBeMended) {
  Add("a.jpg");
  const std::vector<std::pair<std::string, std::string>> files = {
      {"b.tif", "mogrify"},      {"b.HEIC", "heif-convert"},
      {"b.nef", "darktable"},    {"b.jfif", "rename it to .jpg"},
      {"empty.jpg", "is empty"}, {"x\ny.jpg", "control"},
      {"z\\.jpg", "backslash"},  {"text.png", "neither a JPEG"}};
  for (const auto& [name, says] : files)
    folder_.Write(name, name == "empty.jpg" ? "" : "some text that is no picture");
  Add("small.png", 7, 40);
  Add("A.JPG");
  fs::create_symlink("nowhere", folder_ / "link.jpg");
  const PhotoFolder folder = Inspect();
  for (const auto& [name, says] : files)
    EXPECT_THAT(folder.faults, testing::Contains(HasSubstr(says))) << name;
  for (const char* says :
       {"small.png: has 7 x 40", "in case alone", "link.jpg: is a link that leads nowhere"}) {
    EXPECT_THAT(folder.faults, testing::Contains(HasSubstr(says)));
  }
  EXPECT_EQ(folder.faults.size(), files.size() + 3);
}

// Half of a scan may lie behind such a link; without a word the scan would do without it.
TEST_F(PhotoFolderTest, LinksToFoldersAreNamedAndThoseToFilesAreFollowed) {
  Add("photos/a.jpg");
  Add("elsewhere/c.jpg");
  fs::create_directories(folder_ / "photos/sub");
  fs::create_symlink("../elsewhere/c.jpg", folder_ / "photos/b.jpg");
  fs::create_directory_symlink("../elsewhere", folder_ / "photos/.thumbnails");
  EXPECT_THAT(InspectPhotoFolder(folder_ / "photos").faults, IsEmpty());
  fs::create_directory_symlink(folder_ / "elsewhere", folder_ / "photos/station2");
  fs::create_directory_symlink("../../elsewhere", folder_ / "photos/sub/x.jpg");
  fs::create_directory_symlink("..", folder_ / "photos/sub/loop");
  fs::create_directory_symlink("photos", folder_ / "given");  // the folder itself may be one
  for (const char* given : {"photos", "given"}) {
    const PhotoFolder folder = InspectPhotoFolder(folder_ / given);
    std::vector<std::string> names;
    for (const PhotoFile& photo : folder.photos) names.push_back(photo.name);
    EXPECT_THAT(names, ElementsAre("a.jpg", "b.jpg")) << given;
    EXPECT_THAT(folder.faults, ElementsAre(AllOf(HasSubstr("station2: is a link to a folder"),
                                                 HasSubstr("give that folder itself, or"),
                                                 HasSubstr("a copy or a bind mount of its photos")),
                                           HasSubstr("sub/loop: is a link to a folder"),
                                           HasSubstr("sub/x.jpg: is a link to a folder")))
        << given;
  }
}

TEST_F(PhotoFolderTest, EveryCutIsFound) {
  for (const char* name : {"a.jpg", "a.png"}) {
    Add(name);
    const std::string whole = folder_.Read(name);
    // The last byte of a PNG is that of a checksum, which only decoding looks at.
    const size_t last = whole.size() - (name[2] == 'p' ? 8 : 1);
    for (size_t length = 0; length <= last; length += 1 + length / 8) {
      folder_.Write(name, whole.substr(0, length));
      EXPECT_EQ(Inspect().faults.size(), 1U) << name << " of " << length << " bytes";
    }
    folder_.Write(name, whole + std::string(200'000, 'x'));  // what phones append
    EXPECT_THAT(Inspect().faults, IsEmpty()) << name;
    folder_.Write(name, whole);
  }
}

// A thumbnail's end is not the photo's.
TEST_F(PhotoFolderTest, CutOffPhotoWithAThumbnail) {
  Add("a.jpg");
  const std::string whole = folder_.Read("a.jpg");
  const std::string thumbnail = std::string("\xFF\xE1\x00\x08", 4) + "ab\xFF\xD9zz";
  folder_.Write("a.jpg", whole.substr(0, 2) + thumbnail + whole.substr(2));
  EXPECT_THAT(Inspect().faults, IsEmpty());
  folder_.Write("a.jpg", whole.substr(0, 2) + thumbnail + whole.substr(2, whole.size() - 100));
  EXPECT_THAT(Inspect().faults, ElementsAre(HasSubstr("ends before its pixels do")));
}

TEST(FindMask, ColmapsNameThenTheShorterOne) {
  const TemporaryFolder folder;
  EXPECT_EQ(FindMask(folder.path(), "sub/a.jpg"), fs::path());
  folder.Write("sub/a.png", "x");
  EXPECT_EQ(FindMask(folder.path(), "sub/a.jpg"), folder.path() / "sub/a.png");
  folder.Write("sub/a.jpg.png", "x");
  EXPECT_EQ(FindMask(folder.path(), "sub/a.jpg"), folder.path() / "sub/a.jpg.png");
}

}  // namespace
}  // namespace s2gs
