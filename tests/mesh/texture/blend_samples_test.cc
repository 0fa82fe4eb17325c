#include "mesh/texture/blend_samples.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "mesh/light/turn_light.h"
#include "mesh/texture/photo_tones.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

TexelCandidate Candidate(int photo, float weight, int smooth, int detail = 0) {
  TexelCandidate candidate;
  candidate.photo = static_cast<uint16_t>(photo);
  candidate.sample.weight = weight;
  for (int c = 0; c < 3; ++c) {
    candidate.sample.smooth[c] = static_cast<uint8_t>(smooth + 10 * c);
    candidate.sample.color[c] = static_cast<uint8_t>(smooth + 10 * c + detail);
  }
  return candidate;
}

SeenColor Seen(const std::vector<TexelCandidate>& photos, const std::vector<PhotoTone>& tones) {
  SeenColor seen;
  for (const TexelCandidate& photo : photos) seen.Add(photo.sample, tones[photo.photo]);
  return seen;
}

// Under even light. \return  the first channel, from which the others differ by ten grey values each.
float Blend(const std::vector<TexelCandidate>& candidates, const std::vector<PhotoTone>& tones) {
  const std::vector<Eigen::Array3f> shades(candidates.size(), Eigen::Array3f::Ones());
  const Eigen::Array3f color =
      BlendSamples(candidates.data(), shades.data(), static_cast<int>(candidates.size()), tones,
                   Seen(candidates, tones))
          .color;
  for (int c = 1; c < 3; ++c) EXPECT_NEAR(color[c], color[0] + 10.0F * static_cast<float>(c), 1e-3);
  return color[0];
}

TEST(BlendSamples, OnePhotoIsTakenAsItIs) {
  EXPECT_NEAR(Blend({Candidate(0, 7, 100, 12)}, std::vector<PhotoTone>(1)), 112, 1e-4);
}

// What is smooth by the weights, the detail by their fourth powers and the squared sharpness.
TEST(BlendSamples, TwoPhotosInTwoBands) {
  std::vector<PhotoTone> tones(2);
  const std::vector<TexelCandidate> both = {Candidate(0, 3, 100, 8), Candidate(1, 1, 104, -4)};
  const double smooth = (3 * 100 + 1 * 104) / 4.0;
  const double small = std::pow(1.0 / 3, 4);
  EXPECT_NEAR(Blend(both, tones), smooth + (8 - 4 * small) / (1 + small), 1e-3);
  tones[1].sharpness = 3;
  EXPECT_NEAR(Blend(both, tones), smooth + (8 - 4 * 9 * small) / (1 + 9 * small), 1e-3);
}

TEST(BlendSamples, GainsMakePhotosComparable) {
  std::vector<PhotoTone> tones(2);
  tones[1].gain = Eigen::Array3f::Constant(2);
  const std::vector<Eigen::Array3f> shades(2, Eigen::Array3f::Ones());
  const std::vector<TexelCandidate> both = {Candidate(0, 1, 100), Candidate(1, 1, 60)};
  const Eigen::Array3f color = BlendSamples(both.data(), shades.data(), 2, tones, Seen(both, tones)).color;
  EXPECT_NEAR(color[0], (100 + 2 * 60) / 2.0, 1e-3);
  EXPECT_NEAR(color[2], (120 + 2 * 80) / 2.0, 1e-3);
}

// Of three, one that is farther off than Tukey's 4.685 times six grey values does not count at all, and one
// that is half as far by (1 - 1/4)^2.
TEST(BlendSamples, WhatStandsOutDoesNotCount) {
  const std::vector<PhotoTone> tones(3);
  EXPECT_NEAR(Blend({Candidate(0, 1, 100), Candidate(1, 1, 100), Candidate(2, 1, 129)}, tones), 100, 1e-3);
  const double reach = 4.685 * 6;
  const double weight = std::pow(1 - 14.0 * 14 / (reach * reach), 2);
  EXPECT_NEAR(Blend({Candidate(0, 1, 100), Candidate(1, 1, 100), Candidate(2, 1, 114)}, tones),
              100 + 14 * weight / (2 + weight), 1e-3);
  // Two are no majority.
  EXPECT_NEAR(Blend({Candidate(0, 1, 100), Candidate(1, 1, 160)}, tones), 130, 1e-3);
  // Of four the median is the mean of the middle two: 102 from 100, 100, 104 and 150.
  const double off = std::pow(1 - 4 / (reach * reach), 2);
  EXPECT_NEAR(
      Blend({Candidate(0, 1, 100), Candidate(1, 1, 100), Candidate(2, 1, 104), Candidate(0, 1, 150)}, tones),
      (2 * off * 100 + off * 104) / (3 * off), 1e-3);
}

// The photo that a full list may lose next has no weight in it.
TEST(BlendSamples, TheLastOfAFullListCountsNothing) {
  std::vector<TexelCandidate> full;
  for (int i = 0; i < kMaxCandidates; ++i)
    full.push_back(Candidate(i, i == 3 ? 1.0F : 2.0F, i == 3 ? 106 : 100));
  const std::vector<PhotoTone> tones(kMaxCandidates);
  const std::vector<Eigen::Array3f> shades(kMaxCandidates, Eigen::Array3f::Ones());
  const auto of_the_list = [&] {
    return BlendSamples(full.data(), shades.data(), kMaxCandidates, tones, {}).color[0];
  };
  EXPECT_NEAR(of_the_list(), 100, 1e-3);
  for (TexelCandidate& candidate : full) candidate.sample.weight = 2;  // none is the last
  EXPECT_GT(of_the_list(), 100.3);
}

// Two photos look at a place at noon and agree without that light; three that see it in the evening are no
// candidates. The smooth colour is the mean of all five by their areas, and the detail is brighter or darker
// with it.
TEST(BlendSamples, TheColorIsUnderTheLightOfAllPhotosThatSeeThePlace) {
  const std::vector<PhotoTone> tones(5);
  const std::vector<TexelCandidate> noon = {Candidate(0, 4, 180, 12), Candidate(1, 4, 180, 12)};
  const std::vector<Eigen::Array3f> shades(2, Eigen::Array3f::Constant(1.7F));
  std::vector<TexelCandidate> all = noon;
  for (int i = 2; i < 5; ++i) all.push_back(Candidate(i, 2, 96));
  const BlendedColor blended = BlendSamples(noon.data(), shades.data(), 2, tones, Seen(all, tones));
  const auto mean = static_cast<float>((8 * 180 + 6 * 96) / 14.0);
  const float smooth = UnderLight(Eigen::Array3f::Constant(180), Eigen::Array3f::Constant(1 / 1.7F))[0];
  EXPECT_NEAR(UnderLight(Eigen::Array3f::Constant(smooth), blended.light)[0], mean, 1e-3);
  const float detailed = UnderLight(Eigen::Array3f::Constant(192), Eigen::Array3f::Constant(1 / 1.7F))[0];
  EXPECT_NEAR(blended.color[0], UnderLight(Eigen::Array3f::Constant(detailed), blended.light)[0], 1e-3);
}

// What stands out among candidates does not count in the light either.
TEST(BlendSamples, WhatStandsOutIsNoLight) {
  const std::vector<PhotoTone> tones(4);
  const std::vector<TexelCandidate> best = {Candidate(0, 1, 100), Candidate(1, 1, 100), Candidate(2, 1, 170)};
  const std::vector<Eigen::Array3f> shades(3, Eigen::Array3f::Ones());
  std::vector<TexelCandidate> all = best;
  all.push_back(Candidate(3, 0.5, 110));
  EXPECT_NEAR(BlendSamples(best.data(), shades.data(), 3, tones, Seen(all, tones)).color[0],
              (2 * 100 + 0.5 * 110) / 2.5, 1e-3);
}

TEST(AddCandidate, KeepsTheTenBest) {
  RandomNumbers random(4);
  std::vector<float> weights;
  TexelCandidate kept[kMaxCandidates];
  uint8_t count = 0;
  for (int i = 0; i < 50; ++i) {
    weights.push_back(static_cast<float>(1 + random.Uniform()));
    AddCandidate(Candidate(i, weights.back(), 0), kept, &count);
    EXPECT_EQ(count, std::min(i + 1, kMaxCandidates));
  }
  std::vector<float> found;
  for (const TexelCandidate& candidate : kept) {
    EXPECT_EQ(weights[candidate.photo], candidate.sample.weight);
    found.push_back(candidate.sample.weight);
  }
  std::sort(found.rbegin(), found.rend());
  std::sort(weights.rbegin(), weights.rend());
  weights.resize(kMaxCandidates);
  EXPECT_EQ(found, weights);
  // Of equal ones the first photos stay.
  count = 0;
  for (int i = 0; i < 20; ++i) AddCandidate(Candidate(i, 1, 0), kept, &count);
  for (const TexelCandidate& candidate : kept) EXPECT_LT(candidate.photo, kMaxCandidates);
  // A better one takes the place of the last of them.
  AddCandidate(Candidate(30, 2, 0), kept, &count);
  EXPECT_EQ(std::count_if(kept, kept + kMaxCandidates, [](const auto& c) { return c.photo == 9; }), 0);
  EXPECT_EQ(std::count_if(kept, kept + kMaxCandidates, [](const auto& c) { return c.photo == 30; }), 1);
}

// Photos of the same 400 places, darker or brighter by a factor in each channel; every fourth place is seen
// by two of them alone, and one photo shows too little.
TEST(EstimateTones, FindsGainsAndSharpness) {
  const std::vector<double> logs = {-0.2, 0.1, 0.1, 0};  // of gains: their sum is 0
  const std::vector<double> details = {4, 8, 8, 8};
  RandomNumbers random(7);
  std::vector<ToneSample> samples;
  for (uint32_t place = 0; place < 400; ++place) {
    const double grey = 60 + 100 * random.Uniform();
    for (int photo = 0; photo < 4; ++photo) {
      if (photo == 3 && place >= 90) continue;  // fewer than a hundred
      if (photo == 2 && place % 4 == 0) continue;
      ToneSample s;
      s.place = place;
      s.photo = static_cast<uint16_t>(photo);
      for (int c = 0; c < 3; ++c) {
        const double value = grey * std::exp(-logs[photo] * (c + 1) / 2.0);
        s.sample.smooth[c] = static_cast<uint8_t>(std::lround(value));
        s.sample.color[c] = static_cast<uint8_t>(s.sample.smooth[c] + details[photo]);
      }
      samples.push_back(s);
    }
  }
  const std::vector<PhotoTone> tones = EstimateTones(samples, 4);
  for (int photo = 0; photo < 3; ++photo) {
    for (int c = 0; c < 3; ++c) {
      // Values are whole numbers; medians of hundreds are exact to a few thousandths.
      EXPECT_NEAR(std::log(tones[photo].gain[c]), logs[photo] * (c + 1) / 2.0, 0.006) << photo << " " << c;
    }
  }
  EXPECT_EQ(tones[3].gain[0], 1);
  EXPECT_EQ(tones[3].sharpness, 1);
  // Beside the mean of a place's photos: of 4, 8 and 8 mostly.
  EXPECT_NEAR(tones[0].sharpness, 4 / (20 / 3.0), 1e-4);
  EXPECT_NEAR(tones[1].sharpness, 8 / (20 / 3.0), 1e-4);
  EXPECT_TRUE(EstimateTones({}, 2)[1].gain.isOnes());
}

}  // namespace
}  // namespace s2gs
