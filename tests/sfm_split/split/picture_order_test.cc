#include "sfm_split/split/picture_order.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <numeric>
#include <random>
#include <utility>
#include <vector>

namespace s2gs {
namespace {

constexpr int kWidth = 120;
constexpr int kHeight = 90;

// A blob that goes around on an ellipse in front of a pattern, with noise and an exposure of its own.
GreyPicture PictureAt(double turn, double gain, std::mt19937* rng) {
  GreyPicture picture;
  picture.photo_size = {kWidth, kHeight};
  picture.width = kWidth;
  picture.height = kHeight;
  std::normal_distribution<double> noise(0, 3);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const double dx = x - 60 - 25 * std::cos(turn);
      const double dy = y - 45 - 15 * std::sin(turn);
      const double value = 60 + 30 * std::sin(0.3 * x) + 60 * std::exp(-(dx * dx + dy * dy) / 200);
      picture.grey.push_back(
          static_cast<uint8_t>(std::clamp(std::lround(gain * value + noise(*rng)), 0L, 255L)));
    }
  }
  return picture;
}

struct Turn {
  std::vector<GreyPicture> pictures;  // in the order of names
  std::vector<uint32_t> step;         // of each
  std::vector<uint8_t> is_active;

  std::vector<uint32_t> Order() const {
    std::vector<const GreyPicture*> photos;
    for (const GreyPicture& picture : pictures) photos.push_back(&picture);
    std::vector<uint32_t> by_name(photos.size());
    std::iota(by_name.begin(), by_name.end(), 0U);
    return OrderByPictures(photos, is_active, by_name);
  }
};

Turn MakeTurn(uint32_t num, bool shuffled, uint32_t seed) {
  std::mt19937 rng(seed);
  Turn turn;
  turn.step.resize(num);
  std::iota(turn.step.begin(), turn.step.end(), 0U);
  if (shuffled) std::shuffle(turn.step.begin(), turn.step.end(), rng);
  std::uniform_real_distribution<double> gain(0.7, 1.3);
  for (const uint32_t step : turn.step)
    turn.pictures.push_back(PictureAt(6.2831853 * step / num, gain(rng), &rng));
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x)
      turn.is_active.push_back(std::abs(x - 60) < 40 && std::abs(y - 45) < 30 ? 1 : 0);
  }
  return turn;
}

TEST(PictureOrder, ShuffledPhotosComeInTheTablesOrder) {
  for (const uint32_t seed : {1U, 2U, 3U}) {
    const Turn turn = MakeTurn(20, true, seed);
    const std::vector<uint32_t> order = turn.Order();
    ASSERT_EQ(order.size(), 20U);
    for (size_t k = 0; k < order.size(); ++k) {
      const int a = static_cast<int>(turn.step[order[k]]);
      const int b = static_cast<int>(turn.step[order[(k + 1) % order.size()]]);
      const int apart = std::abs(a - b);
      EXPECT_EQ(std::min(apart, 20 - apart), 1) << seed << ' ' << k;
    }
  }
}

TEST(PictureOrder, NamesAreKeptWhereTheyTellTheOrder) {
  const std::vector<uint32_t> order = MakeTurn(24, false, 4).Order();
  ASSERT_EQ(order.size(), 24U);
  for (uint32_t k = 0; k < order.size(); ++k) EXPECT_EQ(order[k], k);
}

// Photos of two cameras, named at random: camera by camera, and each as the table turned.
TEST(PictureOrder, CaptureIsOrderedStationByStation) {
  const Turn first = MakeTurn(16, true, 6);
  const Turn second = MakeTurn(12, true, 7);
  std::vector<GreyPicture> photos;
  std::vector<int> step;
  PictureStations stations;
  for (size_t k = 0; k < 16; ++k) {
    for (const auto& [turn, station] : {std::pair{&first, 0}, std::pair{&second, 1}}) {
      if (k >= turn->pictures.size()) continue;
      photos.push_back(turn->pictures[k]);
      step.push_back(static_cast<int>(turn->step[k]));
      stations.station_of_image.push_back(station);
    }
  }
  SceneChanges changes;
  changes.stations = {{first.is_active, 0.3}, {second.is_active, 0.3}};
  std::vector<uint32_t> place(photos.size());
  std::iota(place.begin(), place.end(), 0U);
  const std::vector<uint32_t> order = OrderOfCapture(photos, stations, changes, place);
  ASSERT_EQ(order.size(), 28U);
  for (size_t k = 0; k < 28; ++k) {
    const int station = k < 16 ? 0 : 1;
    const size_t begin = station == 0 ? 0 : 16;
    const int num = station == 0 ? 16 : 12;
    EXPECT_EQ(stations.station_of_image[order[k]], station);
    const size_t next = begin + (k - begin + 1) % static_cast<size_t>(num);
    const int apart = std::abs(step[order[k]] - step[order[next]]);
    EXPECT_EQ(std::min(apart, num - apart), 1) << k;
  }
}

// Thirteen of twenty steps of a turn: the gap is where it begins. Photos that are named in any way come in
// one order, the same pixels first.
TEST(PictureOrder, NamesDoNotChooseWhereTheTurnBeginsAndItsSense) {
  const Turn whole = MakeTurn(20, false, 9);
  const std::vector<GreyPicture> part(whole.pictures.begin(), whole.pictures.begin() + 13);
  std::vector<std::vector<uint8_t>> first_time;
  for (const uint32_t seed : {1U, 2U, 3U, 4U, 5U}) {
    Turn turn = whole;
    turn.pictures = part;
    std::mt19937 rng(seed);
    std::shuffle(turn.pictures.begin(), turn.pictures.end(), rng);
    const std::vector<uint32_t> by_content = OrderByContent(turn.pictures);
    std::vector<const GreyPicture*> photos;
    for (const uint32_t i : by_content) photos.push_back(&turn.pictures[i]);
    std::vector<uint32_t> by_name(photos.size());
    for (uint32_t k = 0; k < by_name.size(); ++k) by_name[by_content[k]] = k;
    const std::vector<uint32_t> order = OrderByPictures(photos, turn.is_active, by_name);
    ASSERT_EQ(order.size(), 13U);
    std::vector<std::vector<uint8_t>> pixels;
    for (const uint32_t k : order) pixels.push_back(photos[k]->grey);
    EXPECT_TRUE(pixels.front() == part.front().grey || pixels.front() == part.back().grey);
    if (first_time.empty()) first_time = pixels;
    EXPECT_EQ(pixels, first_time) << seed;
  }
}

TEST(PictureOrder, CaptureIsAsGivenWhereNamesTellIt) {
  Turn turn = MakeTurn(20, false, 8);
  PictureStations stations;
  stations.station_of_image.assign(20, 0);
  SceneChanges changes;
  changes.stations = {{turn.is_active, 0.3}};
  std::vector<uint32_t> place(20);
  std::iota(place.begin(), place.end(), 0U);
  EXPECT_TRUE(OrderOfCapture(turn.pictures, stations, changes, place).empty());
  // The same photos in another order, with the same names.
  std::rotate(turn.pictures.begin(), turn.pictures.begin() + 7, turn.pictures.end());
  std::rotate(place.begin(), place.begin() + 7, place.end());
  EXPECT_TRUE(OrderOfCapture(turn.pictures, stations, changes, place).empty());
}

TEST(PictureOrder, NothingIsSaidWhereNothingChanges) {
  Turn turn = MakeTurn(8, false, 5);
  std::fill(turn.is_active.begin(), turn.is_active.end(), uint8_t{0});
  EXPECT_TRUE(turn.Order().empty());
  turn.is_active.clear();
  EXPECT_TRUE(turn.Order().empty());
}

}  // namespace
}  // namespace s2gs
