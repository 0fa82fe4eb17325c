#include "plugin/outputs/split_overlay.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "s2gs/image/image_file.h"
#include "sfm_split/base/error.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

constexpr int kWidth = 400;  // a rotating keypoint's dot has a radius of 1.6 pixels
constexpr int kHeight = 300;

class Listener : public Reporter {
 public:
  void Log(LogLevel level, std::string_view /*message*/) override {
    if (level == LogLevel::kWarning) ++num_warnings;
  }
  bool StopRequested() const override { return stop; }
  int num_warnings = 0;
  bool stop = false;
};

class SplitOverlay : public testing::Test {
 protected:
  void Add(const std::string& name, bool has_photo) {
    if (has_photo) {
      std::filesystem::create_directories((folder_ / "photos" / name).parent_path());
      WriteImage(folder_ / "photos" / name,
                 Image8{kWidth, kHeight, 3, std::vector<uint8_t>(kWidth * kHeight * 3, 200)});
    }
    SplitImage image;
    image.name = name;
    image.size = {kWidth, kHeight};
    image.keypoints = {{50.5F, 60.5F}, {150.5F, 60.5F}, {250.5F, 60.5F}, {399.9F, 299.9F}, {-50, 1000}};
    features_.images.push_back(image);
    split_.labels.push_back({KeypointLabel::kRotating, KeypointLabel::kStatic, KeypointLabel::kUnknown,
                             KeypointLabel::kRotating, KeypointLabel::kRotating});
  }
  int Draw(int max_photos) {
    return WriteSplitOverlays(folder_ / "overlays", folder_ / "photos", features_, split_, max_photos,
                              reporter_);
  }
  std::vector<std::string> Drawn() const {
    std::vector<std::string> names;
    for (const auto& entry : std::filesystem::recursive_directory_iterator(folder_ / "overlays")) {
      if (entry.is_regular_file())
        names.push_back(entry.path().lexically_relative(folder_ / "overlays").string());
    }
    std::sort(names.begin(), names.end());
    return names;
  }

  const TemporaryFolder folder_;
  Listener reporter_;
  SplitFeatures features_;
  MotionSplit split_;
};

TEST_F(SplitOverlay, DotsShowTheLabels) {
  Add("a.png", true);
  ASSERT_EQ(Draw(5), 1);
  EXPECT_EQ(Drawn(), std::vector<std::string>{"a.png.jpg"});
  const Image8 image = ReadImage(folder_ / "overlays/a.png.jpg", 3);
  ASSERT_EQ(image.width, kWidth);
  ASSERT_EQ(image.height, kHeight);
  const auto at = [&](int x, int y, int channel) { return static_cast<int>(image.Pixel(x, y)[channel]); };
  EXPECT_GT(at(50, 60, 0), at(50, 60, 2) + 60);     // orange
  EXPECT_GT(at(150, 60, 2), at(150, 60, 0) + 60);   // blue
  EXPECT_NEAR(at(250, 60, 0), at(250, 60, 2), 12);  // grey
  EXPECT_GT(at(399, 299, 0), at(399, 299, 2) + 20);
  for (int channel = 0; channel < 3; ++channel) EXPECT_NEAR(at(200, 200, channel), 140, 3);  // 70 % of 200
}

TEST_F(SplitOverlay, PhotosAreSpreadEvenly) {
  for (const char* name : {"a.jpg", "b.jpg", "sub/c.jpg", "d.jpg"}) Add(name, true);
  EXPECT_EQ(Draw(2), 2);
  EXPECT_EQ(Drawn(), (std::vector<std::string>{"a.jpg", "sub/c.jpg"}));
  EXPECT_EQ(reporter_.num_warnings, 0);
}

TEST_F(SplitOverlay, PhotosThatCannotBeReadAreLeftOut) {
  Add("a.jpg", false);
  Add("b.jpg", true);
  WriteAll(folder_ / "photos/c.jpg", "no photo");
  Add("c.jpg", false);
  EXPECT_EQ(Draw(3), 1);
  EXPECT_EQ(Drawn(), std::vector<std::string>{"b.jpg"});
  EXPECT_EQ(reporter_.num_warnings, 2);
  reporter_.stop = true;
  EXPECT_THROW(Draw(3), Interrupted);
}

}  // namespace
}  // namespace s2gs
