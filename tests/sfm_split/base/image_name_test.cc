#include "sfm_split/base/image_name.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "sfm_split/base/error.h"
#include "sfm_split/base/printable.h"
#include "tests/support/hostile_names.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

std::string ErrorOf(const std::function<void()>& action) {
  try {
    action();
  } catch (const UserError& error) {
    return error.what();
  }
  return "";
}

TEST(ImageNameBadInput, HostileNamesAreRefused) {
  for (const std::string& name : HostileNames()) {
    EXPECT_TRUE(ImageName::FindFault(name).has_value()) << Printable(name);
    const std::string error = ErrorOf([&] { ImageName(name, "images.bin"); });
    EXPECT_THAT(error, testing::StartsWith("images.bin: the image name \""));
    // What is shown is one line that no terminal takes for a command.
    EXPECT_EQ(error, Printable(error));
    EXPECT_EQ(error.find('\n'), std::string::npos);
  }
}

TEST(ImageName, OrdinaryNamesPass) {
  for (const char* name :
       {"a.jpg", "sub/a.jpg", "IMG 0001 (2).JPG", "a/b/c/d.png", "..a", "a..jpg", ".hidden.jpg",
        "\xC3\xA4\xE6\x97\xA5\xF0\x9F\x93\xB7.jpg", "-rf", "$(x);'\".jpg", "a.jpg.png"}) {
    EXPECT_EQ(ImageName::FindFault(name), std::nullopt) << name;
    EXPECT_EQ(ImageName(name, "x").text(), name);
  }
  EXPECT_EQ(ImageName::FindFault(std::string(240, 'a')), std::nullopt);
}

// RFC 3629's own borders.
TEST(Printable, OnlyUtf8WithoutControlsStays) {
  EXPECT_EQ(Printable("a\tb\nc"), "a\tb\nc");
  EXPECT_EQ(Printable("\x1b[31mred\x1b[0m\r\a\x7f"), "\\x1b[31mred\\x1b[0m\\x0d\\x07\\x7f");
  EXPECT_EQ(Printable("\xC3\xA4\xED\x9F\xBF\xEE\x80\x80\xF4\x8F\xBF\xBF"),
            "\xC3\xA4\xED\x9F\xBF\xEE\x80\x80\xF4\x8F\xBF\xBF");
  EXPECT_EQ(Printable("\xC2\x9B"), "\\xc2\\x9b");                    // C1: another way to begin an escape
  EXPECT_EQ(Printable("\xC0\xAF"), "\\xc0\\xaf");                    // '/' in two bytes
  EXPECT_EQ(Printable("\xE0\x80\xAF"), "\\xe0\\x80\\xaf");           // in three
  EXPECT_EQ(Printable("\xED\xA0\x80"), "\\xed\\xa0\\x80");           // a surrogate
  EXPECT_EQ(Printable("\xF4\x90\x80\x80"), "\\xf4\\x90\\x80\\x80");  // beyond U+10FFFF
  EXPECT_EQ(Printable("\xE2\x82"), "\\xe2\\x82");                    // cut off
  EXPECT_EQ(Printable(std::string("a\0b", 3)), "a\\x00b");
}

class ImageOutputsTest : public testing::Test {
 protected:
  static std::string ErrorAt(const ImageOutputs& outputs, const fs::path& folder, const std::string& name,
                             const std::string& suffix = "") {
    return ErrorOf([&] { outputs.Make(folder, ImageName(name, "x"), suffix); });
  }

  TemporaryFolder folder_;
  fs::path root_ = folder_ / "scan";
  fs::path photos_ = folder_ / "photos";
  void SetUp() override {
    fs::create_directories(root_);
    WriteAll(photos_ / "a.jpg", "photo");
    WriteAll(photos_ / "sub/b.jpg", "photo");
  }
};

TEST_F(ImageOutputsTest, FoldersAreMade) {
  const ImageOutputs outputs(root_, photos_, {"a.jpg", "sub/b.jpg"});
  EXPECT_EQ(outputs.Make(root_ / "masks", ImageName("sub/b.jpg", "x"), ".png"),
            root_ / "masks/sub/b.jpg.png");
  EXPECT_TRUE(fs::is_directory(root_ / "masks/sub"));
}

TEST_F(ImageOutputsTest, NothingLeavesTheRoot) {
  const ImageOutputs outputs(root_, photos_, {"a.jpg"});
  EXPECT_THAT(ErrorAt(outputs, folder_ / "elsewhere", "a.jpg"), HasSubstr("outside"));
  // "scan-2" begins like "scan", but does not lie in it.
  EXPECT_THAT(ErrorAt(outputs, folder_ / "scan-2", "a.jpg"), HasSubstr("outside"));
  EXPECT_FALSE(fs::exists(folder_ / "elsewhere"));
  fs::create_directories(folder_ / "outside");
  fs::create_directory_symlink(folder_ / "outside", root_ / "masks");
  EXPECT_THAT(ErrorAt(outputs, root_ / "masks", "a.jpg", ".png"), HasSubstr("symbolic link"));
  fs::create_directories(root_ / "dense");
  fs::create_directory_symlink(folder_ / "outside", root_ / "dense/sub");
  EXPECT_THAT(ErrorAt(outputs, root_ / "dense", "sub/b.jpg"), HasSubstr("symbolic link"));
  EXPECT_TRUE(fs::is_empty(folder_ / "outside"));
}

TEST_F(ImageOutputsTest, LinksWithinTheRootAndToTheRootAreFollowed) {
  fs::create_directories(root_ / "real");
  fs::create_directory_symlink("real", root_ / "masks");
  fs::create_directory_symlink(root_, folder_ / "link");
  const ImageOutputs outputs(folder_ / "link", photos_, {"a.jpg"});
  EXPECT_EQ(ErrorAt(outputs, folder_ / "link/masks", "a.jpg", ".png"), "");
  EXPECT_EQ(ErrorAt(outputs, root_ / "masks", "a.jpg", ".png"), "");
}

TEST_F(ImageOutputsTest, PhotosAreNotWrittenOver) {
  fs::create_directories(root_ / "dense/images");
  fs::create_symlink(photos_ / "a.jpg", root_ / "dense/images/a.jpg");
  EXPECT_NE(ErrorAt(ImageOutputs(root_, photos_, {"a.jpg"}), root_ / "dense/images", "a.jpg"), "");
  // The photos' folder lies in the workspace, or is one that is written.
  const ImageOutputs inside(root_, root_ / "images", {"a.jpg"});
  EXPECT_THAT(ErrorAt(inside, root_ / "images", "c.jpg"), HasSubstr("photos' folder"));
  EXPECT_EQ(ErrorAt(inside, root_ / "images2", "a.jpg"), "");
  // Names that no photo may have are none of a photo.
  EXPECT_EQ(ErrorAt(ImageOutputs(root_, photos_, {"../scan/overlays/d.jpg"}), root_ / "overlays", "d.jpg"),
            "");
  // The photos' folder holds the workspace.
  const ImageOutputs around(root_, folder_.path(), {"scan/overlays/a.jpg", "photos/a.jpg"});
  EXPECT_THAT(ErrorAt(around, root_ / "overlays", "a.jpg"), HasSubstr("is a photo"));
  EXPECT_EQ(ErrorAt(around, root_ / "overlays", "b.jpg"), "");
  // A photo that is a link to a file in the workspace.
  WriteAll(root_ / "store/c.jpg", "photo");
  fs::create_symlink(root_ / "store/c.jpg", photos_ / "c.jpg");
  EXPECT_THAT(ErrorAt(ImageOutputs(root_, photos_, {"c.jpg"}), root_ / "store", "c.jpg"),
              HasSubstr("is a photo"));
}

}  // namespace
}  // namespace s2gs
