#include "mesh/texture/photo_tones.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <random>
#include <vector>

namespace s2gs {
namespace {

constexpr int kPhotos = 5;
constexpr int kPlaces = 700;

// Places that some of the photos see, each photo with an exposure of its own; the last sees hardly any.
std::vector<ToneSample> Samples() {
  std::mt19937 rng(7);
  std::uniform_int_distribution<int> grey(20, 180);
  std::uniform_int_distribution<int> noise(-3, 3);
  std::vector<ToneSample> samples;
  for (int place = 0; place < kPlaces; ++place) {
    const int here = grey(rng);
    for (int photo = 0; photo < kPhotos; ++photo) {
      if (photo == kPhotos - 1 ? place >= 40 : rng() % 3 == 0) continue;
      ToneSample sample;
      sample.place = static_cast<uint32_t>(place);
      sample.photo = static_cast<uint16_t>(photo);
      for (int c = 0; c < 3; ++c) {
        const double value = here * (1 + .05 * photo * (c + 1)) + noise(rng);
        sample.sample.smooth[c] = static_cast<uint8_t>(std::clamp(value, 0.0, 255.0));
        sample.sample.color[c] = static_cast<uint8_t>(std::clamp(value + noise(rng), 0.0, 255.0));
      }
      samples.push_back(sample);
    }
  }
  return samples;
}

// Medians of places and photos in turn, one after the other.
std::vector<float> GainsOfChannel(const std::vector<ToneSample>& samples, int channel) {
  std::map<uint32_t, int> seen;
  for (const ToneSample& s : samples) ++seen[s.place];
  std::map<uint32_t, std::vector<std::pair<int, float>>> places;
  for (const ToneSample& s : samples) {
    const uint8_t value = s.sample.smooth[channel];
    if (seen[s.place] >= 2 && value >= 12 && value <= 245)
      places[s.place].emplace_back(s.photo, std::log(static_cast<float>(value)));
  }
  std::vector<float> gains(kPhotos, 0);
  for (int round = 0; round < 30; ++round) {
    std::vector<std::vector<float>> lacks(kPhotos);
    for (const auto& [place, values] : places) {
      std::vector<float> here;
      for (const auto& [photo, log] : values) here.push_back(log + gains[photo]);
      std::sort(here.begin(), here.end());
      const float middle = (here[(here.size() - 1) / 2] + here[here.size() / 2]) / 2;
      for (const auto& [photo, log] : values) lacks[photo].push_back(middle - log);
    }
    double sum = 0;
    int count = 0;
    for (int i = 0; i < kPhotos; ++i) {
      if (lacks[i].size() < 100) continue;
      std::sort(lacks[i].begin(), lacks[i].end());
      gains[i] = lacks[i][lacks[i].size() / 2];
      sum += gains[i];
      ++count;
    }
    for (int i = 0; i < kPhotos; ++i) {
      if (lacks[i].size() >= 100) gains[i] -= static_cast<float>(sum / count);
    }
  }
  return gains;
}

TEST(PhotoTones, AreMediansInTurnToTheBitOnAnyNumberOfThreads) {
  const std::vector<ToneSample> samples = Samples();
  const std::vector<PhotoTone> one = EstimateTones(samples, kPhotos, 1);
  const std::vector<PhotoTone> three = EstimateTones(samples, kPhotos, 3);
  ASSERT_EQ(one.size(), static_cast<size_t>(kPhotos));
  for (int c = 0; c < 3; ++c) {
    const std::vector<float> expected = GainsOfChannel(samples, c);
    for (int i = 0; i < kPhotos; ++i) {
      EXPECT_EQ(one[i].gain[c], std::exp(expected[i])) << i << ' ' << c;
      EXPECT_EQ(three[i].gain[c], one[i].gain[c]);
    }
  }
  for (int i = 0; i < kPhotos; ++i) EXPECT_EQ(three[i].sharpness, one[i].sharpness);
  // Brighter photos get a smaller gain, and who shares too few places none.
  EXPECT_LT(one[3].gain[2], one[0].gain[2]);
  EXPECT_EQ(one[kPhotos - 1].gain[0], 1);
}

TEST(PhotoTones, OfNothingAreEven) {
  const std::vector<PhotoTone> tones = EstimateTones({}, 2);
  ASSERT_EQ(tones.size(), 2U);
  EXPECT_TRUE((tones[0].gain == 1).all());
}

}  // namespace
}  // namespace s2gs
