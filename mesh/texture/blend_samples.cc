#include "mesh/texture/blend_samples.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "mesh/light/turn_light.h"
#include "s2gs/image/srgb.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

// Grey values by which photos of one place differ that agree: noise, rounding, the smoothing's borders.
constexpr float kAgreement = 6;
// Tukey's constant: with normal errors, no efficiency to speak of is lost. (Huber, "Robust statistics", 1981)
constexpr float kTukey = 4.685F;
// Among fewer nobody is in the majority.
constexpr int kMinJudges = 3;
// Of all photos' weights: less is rounding.
constexpr float kLeastShare = 1e-4F;
// Grey values that rounding makes of nothing.
constexpr float kDarkest = 0.5F;
// The detail's weight is this power of the smooth part's.
constexpr float kDetailPower = 4;

using Weights = std::array<float, kMaxCandidates>;

float Median(Weights values, int count) {
  std::sort(values.begin(), values.begin() + count);
  return count % 2 != 0 ? values[count / 2] : (values[count / 2 - 1] + values[count / 2]) / 2;
}

using Colors = std::array<Eigen::Array3f, kMaxCandidates>;

// Weights by how far photos' smooth colours are from their median; as they were where no photo would count.
Weights Judged(const Weights& weights, const Colors& smooth, int count) {
  Eigen::Array3f middle;
  for (int c = 0; c < 3; ++c) {
    Weights values{};
    for (int i = 0; i < count; ++i) values[i] = smooth[i][c];
    middle[c] = Median(values, count);
  }
  Weights distances{};
  for (int i = 0; i < count; ++i) distances[i] = (smooth[i] - middle).abs().maxCoeff();
  const float reach =
      kTukey * std::max(kAgreement, static_cast<float>(kSigmaOfMad) * Median(distances, count));
  Weights judged{};
  float sum = 0;
  for (int i = 0; i < count; ++i) {
    const float share = std::min(1.0F, distances[i] / reach);
    judged[i] = weights[i] * (1 - share * share) * (1 - share * share);
    sum += judged[i];
  }
  return sum > 0 ? judged : weights;
}

// How many times as strong light makes one sRGB colour of another.
Eigen::Array3f LightBetween(const Eigen::Array3f& from, const Eigen::Array3f& to) {
  Eigen::Array3f light;
  for (int c = 0; c < 3; ++c) {
    const float before = LightFromSrgb(std::max(kDarkest, from[c]) / 255);
    light[c] = LightFromSrgb(std::max(kDarkest, to[c]) / 255) / before;
  }
  return light;
}

}  // namespace

void AddCandidate(const TexelCandidate& candidate, TexelCandidate* candidates, uint8_t* count) {
  if (*count < kMaxCandidates) {
    candidates[(*count)++] = candidate;
    return;
  }
  TexelCandidate* least =
      std::min_element(candidates, candidates + kMaxCandidates, [](const auto& a, const auto& b) {
        return a.sample.weight != b.sample.weight ? a.sample.weight < b.sample.weight : a.photo > b.photo;
      });
  if (candidate.sample.weight > least->sample.weight) *least = candidate;
}

void SeenColor::Add(const PhotoSample& sample, const PhotoTone& tone, float share) {
  sum += share * sample.weight * tone.gain * ColorOf(sample.smooth);
  weight += share * sample.weight;
}

BlendedColor BlendSamples(const TexelCandidate* candidates, const Eigen::Array3f* shades, int count,
                          const std::vector<PhotoTone>& tones, const SeenColor& seen) {
  Weights weights{};
  float largest = 0;
  float least = candidates[0].sample.weight;
  for (int i = 0; i < count; ++i) {
    weights[i] = candidates[i].sample.weight;
    largest = std::max(largest, weights[i]);
    least = std::min(least, weights[i]);
  }
  // A photo that comes or goes at the end of a full list does so without a step.
  if (count == kMaxCandidates && least < largest) {
    for (int i = 0; i < count; ++i) weights[i] -= least;
    largest -= least;
  }
  // Grey values go about with the root of light. What a photo shows in the dark is made brighter by so much,
  // and its noise with it.
  largest = 0;
  Colors smooth;
  Colors sharp;
  for (int i = 0; i < count; ++i) {
    weights[i] *= shades[i].mean();
    largest = std::max(largest, weights[i]);
    const Eigen::Array3f& gain = tones[candidates[i].photo].gain;
    const Eigen::Array3f unshade = shades[i].inverse();
    smooth[i] = UnderLight(gain * ColorOf(candidates[i].sample.smooth), unshade);
    sharp[i] = UnderLight(gain * ColorOf(candidates[i].sample.color), unshade);
  }
  SeenColor agreed = seen;
  if (count >= kMinJudges) {
    const Weights judged = Judged(weights, smooth, count);
    for (int i = 0; i < count; ++i) {
      const float share = weights[i] > 0 ? judged[i] / weights[i] : 1;
      agreed.Add(candidates[i].sample, tones[candidates[i].photo], share - 1);
    }
    weights = judged;
  }
  Eigen::Array3f smooth_sum = Eigen::Array3f::Zero();
  Eigen::Array3f detail_sum = Eigen::Array3f::Zero();
  float smooth_weight = 0;
  float detail_weight = 0;
  for (int i = 0; i < count; ++i) {
    const PhotoTone& tone = tones[candidates[i].photo];
    smooth_sum += weights[i] * smooth[i];
    smooth_weight += weights[i];
    const float weight = std::pow(weights[i] / largest, kDetailPower) * tone.sharpness * tone.sharpness;
    detail_sum += weight * (sharp[i] - smooth[i]);
    detail_weight += weight;
  }
  const Eigen::Array3f mean = smooth_sum / smooth_weight;
  BlendedColor blended{mean, Eigen::Array3f::Ones()};
  if (detail_weight > 0) blended.color += detail_sum / detail_weight;
  // Rounding may leave nothing of what was all taken out.
  if (agreed.weight > kLeastShare * seen.weight) {
    blended.light = LightBetween(mean, agreed.sum / agreed.weight);
    blended.color = UnderLight(blended.color, blended.light);
  }
  return blended;
}

}  // namespace s2gs
