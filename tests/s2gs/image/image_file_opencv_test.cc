#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

#include "s2gs/image/image_codec.h"
#include "s2gs/image/image_file.h"

namespace s2gs {
namespace {

// A busy image: edges, gradients and noise in all channels.
cv::Mat Scene(int type) {
  cv::Mat image(123, 157, type);
  cv::theRNG().state = 5;
  const double full = image.depth() == CV_16U ? 65535 : 255;
  cv::randu(image, cv::Scalar::all(0), cv::Scalar::all(full));
  cv::GaussianBlur(image, image, {0, 0}, 2);
  cv::normalize(image, image, 0, full, cv::NORM_MINMAX);
  cv::rectangle(image, {20, 30, 50, 40}, cv::Scalar(.1 * full, .9 * full, .4 * full, .5 * full), cv::FILLED);
  cv::circle(image, {100, 60}, 30, cv::Scalar(full, 0, .2 * full, full), 3);
  return image;
}

std::string Encoded(const cv::Mat& image, const char* extension, const std::vector<int>& options) {
  std::vector<uchar> bytes;
  EXPECT_TRUE(cv::imencode(extension, image, bytes, options));
  return {bytes.begin(), bytes.end()};
}

// Largest difference between our decoding and OpenCV's.
int MaxDifference(const std::string& bytes, int channels) {
  const std::vector<uchar> copy(bytes.begin(), bytes.end());
  cv::Mat expected = cv::imdecode(
      copy, (channels == 1 ? cv::IMREAD_GRAYSCALE : cv::IMREAD_COLOR) | cv::IMREAD_IGNORE_ORIENTATION);
  if (channels == 3) cv::cvtColor(expected, expected, cv::COLOR_BGR2RGB);
  const Image8 image = DecodeImage(bytes, "a", channels);
  EXPECT_EQ(image.width, expected.cols);
  EXPECT_EQ(image.height, expected.rows);
  EXPECT_EQ(image.pixels.size(), expected.total() * expected.elemSize());
  int largest = 0;
  for (size_t i = 0; i < image.pixels.size(); ++i) {
    largest = std::max(largest, std::abs(int{image.pixels[i]} - int{expected.data[i]}));
  }
  return largest;
}

TEST(ImageFileOpenCv, JpegsDecodeAlike) {
  // Both are built on the same libjpeg-turbo.
  for (const int progressive : {0, 1}) {
    for (const int restart : {0, 3}) {
      const std::vector<int> options = {cv::IMWRITE_JPEG_QUALITY,      80,
                                        cv::IMWRITE_JPEG_PROGRESSIVE,  progressive,
                                        cv::IMWRITE_JPEG_RST_INTERVAL, restart};
      const std::string color = Encoded(Scene(CV_8UC3), ".jpg", options);
      EXPECT_EQ(MaxDifference(color, 3), 0);
      EXPECT_EQ(MaxDifference(color, 1), 0);
      const std::string grey = Encoded(Scene(CV_8UC1), ".jpg", options);
      EXPECT_EQ(MaxDifference(grey, 3), 0);
      EXPECT_EQ(MaxDifference(grey, 1), 0);
    }
  }
}

TEST(ImageFileOpenCv, PngsDecodeAlike) {
  // OpenCV cuts the lower eight of 16 bits off instead of rounding, and rounds grey in another way.
  for (const int type : {CV_8UC1, CV_8UC3, CV_8UC4, CV_16UC1, CV_16UC3, CV_16UC4}) {
    const std::string png = Encoded(Scene(type), ".png", {});
    const bool is_deep = CV_MAT_DEPTH(type) == CV_16U;
    EXPECT_LE(MaxDifference(png, 3), is_deep ? 1 : 0) << type;
    EXPECT_LE(MaxDifference(png, 1), is_deep || CV_MAT_CN(type) > 1 ? 1 : 0) << type;
  }
  const std::string one_bit = Encoded(Scene(CV_8UC1) > 128, ".png", {cv::IMWRITE_PNG_BILEVEL, 1});
  EXPECT_EQ(MaxDifference(one_bit, 1), 0);
}

TEST(ImageFileOpenCv, OpenCvReadsWhatWeWrite) {
  const cv::Mat scene = Scene(CV_8UC3);
  const Image8 image{scene.cols, scene.rows, 3, {scene.datastart, scene.dataend}};
  EXPECT_EQ(MaxDifference(EncodePng(image, "a.png"), 3), 0);
  EXPECT_EQ(MaxDifference(EncodeJpeg(image, "a.jpg", 95), 3), 0);
  EXPECT_EQ(MaxDifference(EncodeJpeg(image, "a.jpg", 75), 3), 0);
}

}  // namespace
}  // namespace s2gs
