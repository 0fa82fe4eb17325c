#include "sfm_split/split/station_pictures.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <random>
#include <vector>

#include "sfm_split/split/change_maps.h"

namespace s2gs {
namespace {

using Verdict = PictureComparison::Verdict;

constexpr int kWidth = 400;
constexpr int kHeight = 300;
const Eigen::Vector2d kDiscCentre(200, 190);
constexpr double kDiscRadius = 60;  // of an ellipse, half as high

// Smooth texture that reaches over the picture, by seed.
cv::Mat Texture(uint64_t seed, double contrast) {
  cv::Mat fine(kHeight + 100, kWidth + 100, CV_32F);
  cv::RNG random(seed);
  random.fill(fine, cv::RNG::NORMAL, 0, 1);
  cv::Mat coarse;
  cv::GaussianBlur(fine, coarse, {0, 0}, 6);
  cv::GaussianBlur(fine, fine, {0, 0}, 1.8);
  return 110 + contrast * (6 * fine + 12 * coarse);
}

// Rounded and compressed as a photo.
GreyPicture Finish(const cv::Mat& picture, int quality) {
  cv::Mat bytes;
  picture.convertTo(bytes, CV_8U);
  std::vector<uint8_t> file;
  cv::imencode(".jpg", bytes, file, {cv::IMWRITE_JPEG_QUALITY, quality});
  bytes = cv::imdecode(file, cv::IMREAD_GRAYSCALE);
  GreyPicture result;
  result.photo_size = {kWidth, kHeight};
  result.width = kWidth;
  result.height = kHeight;
  result.grey.assign(bytes.datastart, bytes.dataend);
  return result;
}

struct Shot {
  double turn_deg = 0;
  Eigen::Vector2d shift = Eigen::Vector2d::Zero();  // of the wall
  double parallax = 1;                              // things move by so many of the wall's shifts
  double gain = 1;
  double noise = 0;
  int quality = 95;
  bool has_hand = false;
  bool has_checks = false;  // a cloth of a pattern that comes again every three pixels
  uint64_t seed = 1;
};

// A wall, things in front of it that parallax moves otherwise, and a disc with a pattern that turns.
GreyPicture Take(const Shot& shot) {
  static const cv::Mat wall = Texture(1, 10);
  static const cv::Mat things = Texture(2, 10);
  static const cv::Mat disc = Texture(3, 10);
  const auto moved = [&](const cv::Mat& texture, const Eigen::Vector2d& by) {
    const cv::Matx23d map(1, 0, by.x() - 50, 0, 1, by.y() - 50);
    cv::Mat out;
    cv::warpAffine(texture, out, map, {kWidth, kHeight}, cv::INTER_CUBIC);
    return out;
  };
  cv::Mat picture = moved(wall, shot.shift);
  const cv::Mat near = moved(things, shot.parallax * shot.shift);
  for (int x = 10; x < kWidth - 40; x += 80) {
    near(cv::Rect(x, 20 + x % 120, 48, 72)).copyTo(picture(cv::Rect(x, 20 + x % 120, 48, 72)));
  }
  for (int y = shot.has_checks ? kHeight * 2 / 3 : kHeight; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x)
      picture.at<float>(y, x) = static_cast<float>(60 + (x % 3 == 0 ? 60 : 0) + (y % 3 == 0 ? 60 : 0));
  }
  const double c = std::cos(shot.turn_deg * CV_PI / 180);
  const double s = std::sin(shot.turn_deg * CV_PI / 180);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const double u = x - kDiscCentre.x();
      const double v = 2 * (y - kDiscCentre.y());
      if (u * u + v * v > kDiscRadius * kDiscRadius) continue;
      picture.at<float>(y, x) =
          disc.at<float>(static_cast<int>(200 + s * u + c * v), static_cast<int>(200 + c * u - s * v));
    }
  }
  if (shot.has_hand) cv::rectangle(picture, {0, 180}, {120, 299}, cv::Scalar(190), cv::FILLED);
  cv::Mat noise(picture.size(), CV_32F);
  cv::RNG random(shot.seed);
  random.fill(noise, cv::RNG::NORMAL, 0, std::max(shot.noise, 1e-6));
  return Finish(shot.gain * picture + noise, shot.quality);
}

PictureComparison Compare(const Shot& a, const Shot& b) {
  const StationOptions options;
  const PictureStandard standard(Take(a), options.max_shake_px, options.min_unmoved_share, options.min_cells);
  return standard.CompareWith(Take(b));
}

Shot Turned(double degrees, uint64_t seed) {
  Shot shot;
  shot.turn_deg = degrees;
  shot.seed = seed;
  return shot;
}

TEST(PictureStandard, StandsStillUnderExposureNoiseAndCompression) {
  for (const double gain : {0.5, 1.0, 1.8}) {
    for (const int quality : {70, 95}) {
      Shot other = Turned(15, 2);
      other.gain = gain;
      other.noise = 3;
      other.quality = quality;
      const PictureComparison comparison = Compare(Turned(0, 1), other);
      EXPECT_EQ(comparison.verdict, Verdict::kStill) << gain << " " << quality;
      EXPECT_GT(comparison.num_agreeing, comparison.num_textured / 2);
      // A tile's displacement is known to about .1 px, their common motion to less.
      const Eigen::Vector3d middle = comparison.second_from_first * Eigen::Vector3d(200, 150, 1);
      EXPECT_LT((middle.head<2>() / middle.z() - Eigen::Vector2d(200, 150)).norm(), 0.1);
    }
  }
}

TEST(PictureStandard, MeasuresShake) {
  for (const Eigen::Vector2d& shift : {Eigen::Vector2d(1.3, -0.7), Eigen::Vector2d(-7.6, 5.2)}) {
    Shot other = Turned(15, 2);
    other.shift = shift;
    other.noise = 2;
    const PictureComparison comparison = Compare(Turned(0, 1), other);
    EXPECT_EQ(comparison.verdict, Verdict::kStill);
    const Eigen::Vector3d middle = comparison.second_from_first * Eigen::Vector3d(200, 150, 1);
    EXPECT_LT((middle.head<2>() / middle.z() - Eigen::Vector2d(200, 150) - shift).norm(), 0.1);
  }
}

TEST(PictureStandard, IgnoresAHand) {
  Shot other = Turned(30, 2);
  other.has_hand = true;
  EXPECT_EQ(Compare(Turned(0, 1), other).verdict, Verdict::kStill);
}

struct PlainShot {
  double turn_deg = 0;
  double roll_rad = 0;  // of the camera about the picture's middle, before the shift
  double zoom = 1;      // about the same
  Eigen::Vector2d shift = Eigen::Vector2d::Zero();
  double flatness = 0.5;   // of the disc's ellipse: how high the camera stands
  double turning = 50;     // radius of what turns [px]
  bool has_shelf = false;  // two long edges instead of the disc's rim
  bool has_ledge = false;  // a long edge aslant across the wall, with the steps that pixels make of it
  double hidden = 0;       // share of the picture's width that somebody stands before
  double gain = 1;
  uint64_t seed = 1;
};

// A wall of one colour that light falls off on, a disc of one colour, and what turns upon it: all that stays
// and has structure are edges.
GreyPicture TakePlain(const PlainShot& shot) {
  constexpr double kRadius = 130;
  const cv::Mat texture = Texture(3, 10);
  const double c = std::cos(shot.turn_deg * CV_PI / 180);
  const double s = std::sin(shot.turn_deg * CV_PI / 180);
  cv::Mat picture(2 * kHeight, 2 * kWidth, CV_32F);  // twice as fine, against steps along the rim
  for (int y = 0; y < picture.rows; ++y) {
    for (int x = 0; x < picture.cols; ++x) {
      const Eigen::Vector2d middle(0.5 * kWidth, 0.5 * kHeight);
      const Eigen::Vector2d unturned = middle + Eigen::Rotation2Dd(-shot.roll_rad) *
                                                    (0.5 * Eigen::Vector2d(x, y) - shot.shift - middle) /
                                                    shot.zoom;
      const double u = unturned.x() - kDiscCentre.x();
      const double v = unturned.y() - kDiscCentre.y();
      double grey = 170 - 0.05 * y;
      if (shot.has_shelf ? v > -120 && v < 60 : std::hypot(u, v / shot.flatness) < kRadius) grey = 110;
      if (std::hypot(u, 2 * v) < shot.turning)
        grey = texture.at<float>(static_cast<int>(200 + s * u + 2 * c * v),
                                 static_cast<int>(200 + c * u - 2 * s * v));
      if (x < shot.hidden * picture.cols) grey = 60;
      picture.at<float>(y, x) = static_cast<float>(grey);
    }
  }
  cv::resize(picture, picture, {kWidth, kHeight}, 0, 0, cv::INTER_AREA);
  for (int y = 0; shot.has_ledge && y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      if (y - shot.shift.y() < 12 + 0.13 * (x - shot.shift.x())) picture.at<float>(y, x) = 30;
    }
  }
  cv::Mat noise(picture.size(), CV_32F);
  cv::RNG random(shot.seed);
  random.fill(noise, cv::RNG::NORMAL, 0, 1);
  return Finish(shot.gain * picture + noise, 95);
}

PictureComparison ComparePlain(const PlainShot& a, const PlainShot& b) {
  const StationOptions options;
  const PictureStandard standard(TakePlain(a), options.max_shake_px, options.min_unmoved_share,
                                 options.min_cells);
  return standard.CompareWith(TakePlain(b));
}

TEST(PictureStandard, KnowsACameraBeforeAPlainWallByEdges) {
  uint64_t seed = 1;
  for (const double gain : {0.7, 1.0, 1.3}) {
    for (const Eigen::Vector2d& shift : {Eigen::Vector2d(0, 0), Eigen::Vector2d(0.6, 0.3),
                                         Eigen::Vector2d(-1.6, 0.9), Eigen::Vector2d(2.8, 1.9)}) {
      PlainShot other;
      other.turn_deg = 40;
      other.shift = shift;
      other.gain = gain;
      other.seed = ++seed;
      const PictureComparison comparison = ComparePlain({}, other);
      EXPECT_EQ(comparison.verdict, Verdict::kStill) << gain << " " << shift.transpose();
      EXPECT_GT(comparison.num_edges, 10);
      // .09 px at most were measured.
      const Eigen::Vector3d middle = comparison.second_from_first * Eigen::Vector3d(200, 190, 1);
      EXPECT_LT((middle.hnormalized() - Eigen::Vector2d(200, 190) - shift).norm(), 0.15);
    }
  }
}

// The pixels' steps along an edge are texture, and lie where the pixels do, not where the wall does: edges
// tell their places across themselves alone.
TEST(PictureStandard, StepsAlongAnEdgeTellNoPlace) {
  uint64_t seed = 1;
  PlainShot first;
  first.has_ledge = true;
  for (const Eigen::Vector2d& shift : {Eigen::Vector2d(-0.5, -0.3), Eigen::Vector2d(0.8, 0.5),
                                       Eigen::Vector2d(-0.2, 1.6), Eigen::Vector2d(1.4, -0.6)}) {
    PlainShot other = first;
    other.turn_deg = 40;
    other.shift = shift;
    other.seed = ++seed;
    const PictureComparison comparison = ComparePlain(first, other);
    EXPECT_EQ(comparison.verdict, Verdict::kStill) << shift.transpose();
    const Eigen::Vector3d middle = comparison.second_from_first * Eigen::Vector3d(200, 190, 1);
    EXPECT_LT((middle.hnormalized() - Eigen::Vector2d(200, 190) - shift).norm(), 0.2) << shift.transpose();
  }
}

// What rolls by a pixel at the picture's border is no shift, and leaves one more than an edge may differ by.
TEST(PictureStandard, TellsARollByEdges) {
  uint64_t seed = 1;
  for (const double roll : {-0.008, 0.008, 0.012}) {
    PlainShot other;
    other.turn_deg = 40;
    other.roll_rad = roll;
    other.shift = {1.2, -0.8};
    other.seed = ++seed;
    const PictureComparison comparison = ComparePlain({}, other);
    EXPECT_EQ(comparison.verdict, Verdict::kStill) << roll;
    // Of the disc's rim, which is all that tells it: .09 px at most were measured.
    const Eigen::Vector2d middle(0.5 * kWidth, 0.5 * kHeight);
    for (const Eigen::Vector2d& at :
         {Eigen::Vector2d(70, 190), Eigen::Vector2d(330, 190), Eigen::Vector2d(200, 255)}) {
      const Eigen::Vector2d truth = middle + Eigen::Rotation2Dd(roll) * (at - middle) + other.shift;
      const Eigen::Vector3d found = comparison.second_from_first * at.homogeneous();
      EXPECT_LT((found.hnormalized() - truth).norm(), 0.15) << roll << " " << at.transpose();
    }
  }
}

// A lens that focuses anew shows all a little larger: by more at the picture's border than an edge may differ
// by.
TEST(PictureStandard, TellsAGrowthByEdges) {
  uint64_t seed = 1;
  for (const double zoom : {0.994, 1.005, 1.008}) {
    PlainShot other;
    other.turn_deg = 40;
    other.zoom = zoom;
    other.shift = {-0.9, 0.6};
    other.roll_rad = 0.002;
    other.seed = ++seed;
    const PictureComparison comparison = ComparePlain({}, other);
    EXPECT_EQ(comparison.verdict, Verdict::kStill) << zoom;
    const Eigen::Vector2d middle(0.5 * kWidth, 0.5 * kHeight);
    double worst = 0;
    for (const Eigen::Vector2d& at :
         {Eigen::Vector2d(70, 190), Eigen::Vector2d(330, 190), Eigen::Vector2d(200, 255)}) {
      const Eigen::Vector2d truth =
          middle + zoom * (Eigen::Rotation2Dd(other.roll_rad) * (at - middle)) + other.shift;
      const Eigen::Vector3d found = comparison.second_from_first * at.homogeneous();
      worst = std::max(worst, (found.hnormalized() - truth).norm());
    }
    EXPECT_LT(worst, 0.2) << zoom;
  }
}

TEST(PictureStandard, EdgesThatLieElsewhereOrTellOneDirectionProveNothing) {
  PlainShot higher;
  higher.turn_deg = 40;
  higher.flatness = 0.56;
  higher.seed = 2;
  EXPECT_NE(ComparePlain({}, higher).verdict, Verdict::kStill);
  PlainShot shelf;
  shelf.has_shelf = true;
  PlainShot along = shelf;
  along.turn_deg = 40;
  along.shift = {9, 0};
  along.seed = 2;
  const PictureComparison comparison = ComparePlain(shelf, along);
  EXPECT_GT(comparison.num_edges, 10);
  EXPECT_NE(comparison.verdict, Verdict::kStill);
}

TEST(PictureStandard, TellsOtherPlacesAndNothingFromFlatPictures) {
  Shot far = Turned(0, 2);
  far.shift = {37, 11};
  EXPECT_EQ(Compare(Turned(0, 1), far).verdict, Verdict::kMoved);
  GreyPicture flat = Take(Turned(0, 1));
  std::fill(flat.grey.begin(), flat.grey.end(), 128);
  const PictureStandard standard(flat, 12, 0.1, 6);
  EXPECT_EQ(standard.CompareWith(flat).verdict, Verdict::kUnknown);
}

TEST(FindPictureStations, KeepsTripodsApartThatStandClose) {
  // A camera of 1.2 widths moved aside by 1/200 of the distance to a table, turned towards it again: a wall
  // at twice that distance moves by 480 * .005 * (1 - 1/2) = 1.2 px one way, things at .6 of it by 1.6 px the
  // other.
  std::vector<GreyPicture> pictures;
  for (int i = 0; i < 12; ++i) {
    Shot shot = Turned(30.0 * (i % 6), static_cast<uint64_t>(i));
    shot.noise = 2;
    if (i >= 6) shot.shift = {1.2, 0};
    shot.parallax = -1.6 / 1.2;
    pictures.push_back(Take(shot));
  }
  Reporter reporter;
  const PictureStations stations = FindPictureStations(pictures, {}, reporter);
  for (int i = 0; i < 12; ++i) EXPECT_EQ(stations.station_of_image[i], i < 6 ? 0 : 1) << i;
}

TEST(FindPictureStations, WhatLooksTheSameElsewhereTellsOfNoMove) {
  std::vector<GreyPicture> pictures;
  for (int i = 0; i < 12; ++i) {
    Shot shot = Turned(30.0 * i, static_cast<uint64_t>(i));
    shot.noise = 4;
    shot.has_checks = true;
    pictures.push_back(Take(shot));
  }
  Reporter reporter;
  const PictureStations stations = FindPictureStations(pictures, {}, reporter);
  for (int i = 0; i < 12; ++i) EXPECT_EQ(stations.station_of_image[i], 0) << i;
}

TEST(FindPictureStations, IsOneUnderJumpsOfExposureAndShake) {
  std::vector<GreyPicture> pictures;
  for (int i = 0; i < 12; ++i) {
    Shot shot = Turned(30.0 * i, static_cast<uint64_t>(i));
    shot.noise = 2;
    shot.gain = i % 3 == 0 ? 0.6 : 1.4;
    shot.shift = {0.5 * (i % 4), -0.4 * (i % 3)};
    shot.has_hand = i == 5;
    pictures.push_back(Take(shot));
  }
  Reporter reporter;
  const PictureStations stations = FindPictureStations(pictures, {}, reporter);
  for (int i = 0; i < 12; ++i) {
    EXPECT_EQ(stations.station_of_image[i], 0) << i;
    const Eigen::Vector3d middle = stations.photo_from_first[i] * Eigen::Vector3d(200, 150, 1);
    const Eigen::Vector2d shift(0.5 * (i % 4), -0.4 * (i % 3));
    EXPECT_LT((middle.head<2>() / middle.z() - Eigen::Vector2d(200, 150) - shift).norm(), 0.15) << i;
  }
}

// Half of what stays before a plain wall is hidden in one photo, and the standard's other half turns: against
// what the station's photos have in common the rest is enough.
TEST(FindPictureStations, SomebodyBeforeAPlainWallHidesNoStation) {
  std::vector<GreyPicture> pictures;
  for (int i = 0; i < 12; ++i) {
    PlainShot shot;
    shot.turn_deg = 30.0 * i;
    shot.hidden = i == 7 ? 0.45 : 0;
    shot.gain = i % 2 == 0 ? 1.2 : 0.8;
    shot.seed = static_cast<uint64_t>(i + 1);
    pictures.push_back(TakePlain(shot));
  }
  Reporter reporter;
  const PictureStations stations = FindPictureStations(pictures, {}, reporter);
  for (int i = 0; i < 12; ++i) EXPECT_EQ(stations.station_of_image[i], 0) << i;
}

// What turns covers all but the disc's outermost pixels: no photo tells what stays, only what they have in
// common does. Two tripods, and then a camera that is carried, whose photos have no such thing.
TEST(FindPictureStations, MediansTellWhereWhatTurnsFillsTheDisc) {
  std::vector<GreyPicture> pictures;
  std::vector<GreyPicture> carried;
  for (int i = 0; i < 24; ++i) {
    PlainShot shot;
    shot.turn_deg = 30.0 * i + (i < 12 ? 0 : 15);
    shot.turning = 120;
    shot.seed = static_cast<uint64_t>(i + 1);
    if (i >= 12) shot.flatness = 0.56;
    pictures.push_back(TakePlain(shot));
    shot.flatness = 0.5 + 0.012 * i;
    carried.push_back(TakePlain(shot));
  }
  Reporter reporter;
  const PictureStations stations = FindPictureStations(pictures, {}, reporter);
  for (int i = 0; i < 24; ++i) EXPECT_EQ(stations.station_of_image[i], i < 12 ? 0 : 1) << i;
  const PictureStations places = FindPictureStations(carried, {}, reporter);
  EXPECT_GT(*std::max_element(places.station_of_image.begin(), places.station_of_image.end()), 12);
}

// What turns looks the same in every sixth photo: these look like places of four photos each, to which a
// camera would have come back time and again.
TEST(FindPictureStations, WhatLooksAlikeTimeAndAgainIsNoPlace) {
  std::vector<GreyPicture> pictures;
  for (int i = 0; i < 24; ++i) {
    PlainShot shot;
    shot.turn_deg = 60.0 * (i % 6);
    shot.turning = 127;
    shot.seed = static_cast<uint64_t>(i + 1);
    pictures.push_back(TakePlain(shot));
  }
  Reporter reporter;
  EXPECT_EQ(FindPictureStations(pictures, {}, reporter).station_of_image, std::vector<int>(24, 0));
}

// What turns by small steps looks alike from photo to photo and is the median of eight of them, too: that of
// many shows what stays, to which each photo bears witness by less than a station's share of tiles.
TEST(FindPictureStations, MediansOfManyTellWhereSmallStepsLookAlike) {
  std::vector<GreyPicture> pictures;
  for (int i = 0; i < 48; ++i) {
    PlainShot shot;
    shot.turn_deg = 15.0 * i + (i < 24 ? 0 : 7.5);
    shot.turning = 124;
    shot.seed = static_cast<uint64_t>(i + 1);
    if (i >= 24) shot.flatness = 0.56;
    pictures.push_back(TakePlain(shot));
  }
  Reporter reporter;
  const PictureStations stations = FindPictureStations(pictures, {}, reporter);
  for (int i = 0; i < 48; ++i) EXPECT_EQ(stations.station_of_image[i], i < 24 ? 0 : 1) << i;
}

// Somebody hides most of what stays in a photo, or in two. Amid the station's photos they belong to them; at
// the end, and where the camera stood elsewhere for one, it does not.
TEST(FindPictureStations, OrderSpeaksForPhotosAmidAStation) {
  const auto stations_of = [](int odd, double hidden, double flatness, int num_odd = 1) {
    std::vector<GreyPicture> pictures;
    for (int i = 0; i < 12; ++i) {
      PlainShot shot;
      shot.turn_deg = 30.0 * i;
      shot.seed = static_cast<uint64_t>(i + 1);
      if (i >= odd && i < odd + num_odd) {
        shot.hidden = hidden;
        shot.flatness = flatness;
      }
      pictures.push_back(TakePlain(shot));
    }
    Reporter reporter;
    return FindPictureStations(pictures, {}, reporter).station_of_image;
  };
  EXPECT_EQ(stations_of(5, 0.6, 0.5), std::vector<int>(12, 0));  // from .55 to .65
  std::vector<int> one_at_the_end(12, 0);
  one_at_the_end[11] = 1;
  EXPECT_EQ(stations_of(11, 0.6, 0.5), one_at_the_end);
  EXPECT_EQ(stations_of(5, 0, 0.56)[5], 1);
  EXPECT_EQ(stations_of(5, 0.6, 0.5, 2), std::vector<int>(12, 0));
  EXPECT_EQ(stations_of(5, 0, 0.56, 2)[6], 1);
}

TEST(JoinStations, FeaturesJoinWhatPicturesDoNotTellButNotWhatTheyContradict) {
  std::vector<GreyPicture> flat(3, Take(Turned(0, 1)));
  for (GreyPicture& picture : flat) std::fill(picture.grey.begin(), picture.grey.end(), 128);
  Reporter reporter;
  PictureStations alone = FindPictureStations(flat, {}, reporter);
  const std::vector<StationJoin> joins = {{0, 2, 50, {1, 0}}};
  Stations joined = JoinStations(flat, alone, joins, {});
  EXPECT_EQ(joined.station_of_image, std::vector<int>({0, 1, 0}));
  EXPECT_LT((joined.Move(0, 2, {10, 10}) - Eigen::Vector2f(11, 10)).norm(), 1e-4F);

  Shot far = Turned(0, 2);
  far.shift = {37, 11};
  const std::vector<GreyPicture> apart = {Take(Turned(0, 1)), Take(far)};
  joined = JoinStations(apart, FindPictureStations(apart, {}, reporter), {{0, 1, 50, {1, 0}}}, {});
  EXPECT_EQ(joined.station_of_image, std::vector<int>({0, 1}));
}

TEST(FindChanges, ShowsWhatTurnsAndNothingElse) {
  std::vector<GreyPicture> pictures;
  for (int i = 0; i < 10; ++i) {
    Shot shot = Turned(36.0 * i, static_cast<uint64_t>(i));
    shot.noise = 2;
    shot.gain = i % 2 == 0 ? 0.7 : 1.2;
    shot.has_hand = i == 3;
    pictures.push_back(Take(shot));
  }
  Reporter reporter;
  const PictureStations stations = FindPictureStations(pictures, {}, reporter);
  const SceneChanges changes = FindChanges(pictures, stations);
  ASSERT_EQ(changes.stations.size(), 1U);
  int both = 0;
  int either = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const double u = x - kDiscCentre.x();
      const double v = 2 * (y - kDiscCentre.y());
      const bool turns = u * u + v * v <= kDiscRadius * kDiscRadius;
      const bool found = changes.stations[0].is_active[static_cast<size_t>(y) * kWidth + x] != 0;
      both += turns && found ? 1 : 0;
      either += turns || found ? 1 : 0;
    }
  }
  // The hand shows in one photo alone and counts in that one's map.
  EXPECT_GT(static_cast<double>(both) / either, 0.85);
  EXPECT_GT(changes.photos[3].deviation[static_cast<size_t>(250) * kWidth + 60], 100);
  EXPECT_LT(changes.photos[4].deviation[static_cast<size_t>(250) * kWidth + 60], 100);
  EXPECT_EQ(ActivePart(pictures[0], stations.photo_from_first[0], changes.stations[0]),
            changes.stations[0].is_active);
}

// A hand that shows in two photos of ten changes again and again, but the table changes in most.
TEST(FindChanges, TheTableIsBusyAndAHandIsNot) {
  std::vector<GreyPicture> pictures;
  for (int i = 0; i < 10; ++i) {
    Shot shot = Turned(36.0 * i, static_cast<uint64_t>(i));
    shot.noise = 2;
    shot.has_hand = i == 3 || i == 4;
    pictures.push_back(Take(shot));
  }
  Reporter reporter;
  const PictureStations stations = FindPictureStations(pictures, {}, reporter);
  const SceneChanges changes = FindChanges(pictures, stations);
  ASSERT_EQ(changes.stations.size(), 1U);
  EXPECT_EQ(changes.stations[0].is_active[static_cast<size_t>(250) * kWidth + 60], 1);
  const auto is_busy = [&](double x, double y) {
    return IsBusy(pictures[3], stations.photo_from_first[3], changes.stations[0],
                  Eigen::Vector2d(x, y).cast<float>());
  };
  EXPECT_FALSE(is_busy(60, 250));
  EXPECT_FALSE(is_busy(60, 60));
  for (const double u : {-0.8, 0.0, 0.8}) {
    EXPECT_TRUE(is_busy(kDiscCentre.x() + u * kDiscRadius, kDiscCentre.y())) << u;
    EXPECT_TRUE(is_busy(kDiscCentre.x(), kDiscCentre.y() + 0.5 * u * kDiscRadius)) << u;
  }
  EXPECT_TRUE(is_busy(-5, 60)) << "outside of what the station's first photo shows nothing is known";
  EXPECT_TRUE(IsBusy(pictures[3], stations.photo_from_first[3], {}, {60, 250})) << "too few photos to tell";
}

TEST(FindChanges, SeesNothingWhereNothingTurns) {
  std::vector<GreyPicture> pictures;
  for (int i = 0; i < 10; ++i) {
    Shot shot = Turned(0, static_cast<uint64_t>(i));
    shot.noise = 3;
    shot.quality = 70;
    shot.gain = i % 2 == 0 ? 0.7 : 1.3;
    pictures.push_back(Take(shot));
  }
  Reporter reporter;
  const SceneChanges changes = FindChanges(pictures, FindPictureStations(pictures, {}, reporter));
  EXPECT_EQ(changes.MedianActiveShare(), 0);
}

// A body's form [grey values], smooth and seen alike from all around.
cv::Mat Form() {
  cv::Mat form(kHeight + 100, kWidth + 100, CV_32F);
  cv::RNG random(2);
  random.fill(form, cv::RNG::NORMAL, 0, 1);
  cv::GaussianBlur(form, form, {0, 0}, 6);
  cv::Scalar mean;
  cv::Scalar deviation;
  cv::meanStdDev(form, mean, deviation);
  return 30 / deviation[0] * form;
}

// Before a wall of which little has structure a body beside the axis, which goes to and fro. What is painted
// on it is seen from every side another, and from three sides hardly.
TEST(FindPictureStations, ABodyThatLooksAlikeFromAllAroundIsNoShake) {
  const cv::Mat wall = Texture(1, 10);
  const cv::Mat form = Form();
  std::vector<GreyPicture> pictures;
  for (int k = 0; k < 24; ++k) {
    const cv::Mat body = form + Texture(10 + k, k % 8 == 5 ? 2 : 8);
    cv::Mat picture(kHeight, kWidth, CV_32F, cv::Scalar(110));
    for (const int x : {0, kWidth - 72}) {
      const cv::Rect place(x, 0, 72, 172);
      wall(place).copyTo(picture(place));
    }
    const auto moved = static_cast<float>(6 * std::sin(2 * CV_PI * k / 24));
    const cv::Matx23f map(1, 0, moved - 50, 0, 1, -50);
    cv::Mat shown;
    cv::warpAffine(body, shown, map, {kWidth, kHeight}, cv::INTER_CUBIC);
    const cv::Rect front(120 + cvRound(moved), 40, 160, 240);
    shown(front).copyTo(picture(front));
    pictures.push_back(Finish(picture, 95));
  }
  Reporter reporter;
  const PictureStations stations = FindPictureStations(pictures, {}, reporter);
  EXPECT_EQ(stations.station_of_image, std::vector<int>(24, 0));
  for (const Eigen::Matrix3d& H : stations.photo_from_first) {
    const Eigen::Vector2d middle(0.5 * kWidth, 0.5 * kHeight);
    EXPECT_LT(((H * middle.homogeneous()).hnormalized() - middle).norm(), 0.2);
  }
}

}  // namespace
}  // namespace s2gs
