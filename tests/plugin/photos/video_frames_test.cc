#include "plugin/photos/video_frames.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <string>
#include <vector>

#include "s2gs/image/image_file.h"
#include "sfm_split/base/error.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using testing::ElementsAre;

TEST(SharpestOfIntervals, OneOfEach) {
  EXPECT_THAT(SharpestOfIntervals({1, 3, 2, 9, 8, 7}, 3), ElementsAre(1, 3, 4));
  EXPECT_THAT(SharpestOfIntervals({1, 3, 2}, 10), ElementsAre(0, 1, 2));
  EXPECT_THAT(SharpestOfIntervals({1, 3, 2, 0, 5, 4, 1}, 2), ElementsAre(1, 4));
  EXPECT_THAT(SharpestOfIntervals({}, 2), testing::IsEmpty());
}

// More than ffmpeg sums up in a row.
TEST(ImportVideo, TakesAsManyFramesAsAreAskedFor) {
  Reporter silent;
  const fs::path ffmpeg = FindFfmpeg("");
  const TemporaryFolder folder;
  const fs::path video = folder / "film.mkv";
  const std::string make = ffmpeg.string() +
                           " -loglevel error -f lavfi -i testsrc=size=16x16:rate=25 -frames:v 250 "
                           "-c:v ffv1 \"" +
                           video.string() + "\"";
  ASSERT_EQ(std::system(make.c_str()), 0);
  const Workspace workspace{folder / "w"};
  fs::create_directories(workspace.root);
  constexpr int kNumFrames = 120;
  ImportVideo(ffmpeg, video, kNumFrames, workspace, silent);
  EXPECT_EQ(std::distance(fs::directory_iterator(workspace.Imported()), fs::directory_iterator()),
            kNumFrames);
}

// Every third frame is sharp, the others are blurred: those are taken, and they are what was filmed.
TEST(ImportVideo, TakesTheSharpFrames) {
  Reporter silent;
  const fs::path ffmpeg = FindFfmpeg("");
  const TemporaryFolder folder;
  constexpr int kSide = 64;
  constexpr int kNumFrames = 12;
  for (int frame = 0; frame < kNumFrames; ++frame) {
    Image8 image{kSide, kSide, 3, std::vector<uint8_t>(size_t{3} * kSide * kSide)};
    const bool is_sharp = frame % 3 == 1;
    for (int y = 0; y < kSide; ++y) {
      for (int x = 0; x < kSide; ++x) {
        const bool is_bright = ((x / 4) + (y / 4)) % 2 == 0;
        const auto value = static_cast<uint8_t>(is_sharp ? (is_bright ? 200 : 50) : 120 + 4 * (x % 8));
        for (int c = 0; c < 3; ++c) image.Pixel(x, y)[c] = static_cast<uint8_t>(value + frame);
      }
    }
    std::string number = std::to_string(frame);
    number.insert(0, 3 - number.size(), '0');
    WriteImage(folder / (number + ".png"), image);
  }
  const fs::path video = folder / "it's a film.mkv";  // quoting must hold
  const std::string make = ffmpeg.string() + " -loglevel error -framerate 10 -i " +
                           (folder / "%03d.png").string() + " -c:v ffv1 -pix_fmt bgr0 \"" + video.string() +
                           "\"";
  ASSERT_EQ(std::system(make.c_str()), 0);
  const Workspace workspace{folder / "100%d %s"};  // nor is a folder's name a pattern
  fs::create_directories(workspace.root);
  ImportVideo(ffmpeg, video, 4, workspace, silent);
  for (const int frame : {1, 4, 7, 10}) {
    std::string number = std::to_string(frame);
    number.insert(0, 6 - number.size(), '0');
    const Image8 taken = ReadImage(workspace.Imported() / ("frame_" + number + ".png"), 3);
    EXPECT_EQ(*taken.Pixel(0, 0), 200 + frame) << "lossless";
  }
  size_t count = 0;
  for ([[maybe_unused]] const auto& entry : fs::directory_iterator(workspace.Imported())) ++count;
  EXPECT_EQ(count, 4U);
  EXPECT_FALSE(fs::exists(workspace.Own() / "frames"));

  folder.Write("text.mp4", "no film at all");
  EXPECT_THROW(ImportVideo(ffmpeg, folder / "text.mp4", 4, workspace, silent), UserError);
  EXPECT_THROW(FindFfmpeg(folder / "none"), UserError);
}

}  // namespace
}  // namespace s2gs
