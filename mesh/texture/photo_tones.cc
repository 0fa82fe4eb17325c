#include "mesh/texture/photo_tones.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "mesh/texture/turn_light.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

// Darker values are noise and rounding, brighter ones may be clipped.
constexpr uint8_t kDarkest = 12;
constexpr uint8_t kBrightest = 245;
// A median of so many values has a standard deviation of an eighth of one value's.
constexpr size_t kMinPlaces = 100;
// Medians in turn, of the places and of the photos, until nothing moves by more than rounding does.
constexpr int kRounds = 30;
// A photo without any detail is not better than nothing.
constexpr float kLeastSharpness = 0.1F;

// A channel's value of a sample, without the place's light.
struct Value {
  uint32_t place;
  uint16_t photo;
  float log;
};

// Of one channel, in the order of the samples: those of places that two photos see, neither dark nor clipped.
std::vector<Value> ChannelValues(const std::vector<ToneSample>& samples, const std::vector<int>& num_seen,
                                 int channel) {
  std::vector<Value> values;
  for (const ToneSample& s : samples) {
    const uint8_t value = s.sample.smooth[channel];
    if (num_seen[s.place] < 2 || value < kDarkest || value > kBrightest) continue;
    const Eigen::Array3f unshaded = UnderLight(ColorOf(s.sample.smooth), s.shade.inverse());
    values.push_back({s.place, s.photo, std::log(unshaded[channel])});
  }
  return values;
}

// By photo, what each of its values lacks of its place's median under these gains.
void CollectLacks(const std::vector<Value>& values, const std::vector<float>& gains,
                  std::vector<std::vector<float>>* of_photo) {
  for (auto& list : *of_photo) list.clear();
  for (size_t begin = 0; begin < values.size();) {
    size_t end = begin;
    std::vector<float> here;
    while (end < values.size() && values[end].place == values[begin].place) {
      here.push_back(values[end].log + gains[values[end].photo]);
      ++end;
    }
    std::sort(here.begin(), here.end());
    const float middle = (here[(here.size() - 1) / 2] + here[here.size() / 2]) / 2;
    for (size_t i = begin; i < end; ++i) (*of_photo)[values[i].photo].push_back(middle - values[i].log);
    begin = end;
  }
}

// Logarithms of the photos' gains in one channel.
std::vector<float> FindGains(const std::vector<Value>& values, int num_photos) {
  std::vector<float> gains(num_photos, 0);
  std::vector<std::vector<float>> of_photo(num_photos);
  for (int round = 0; round < kRounds; ++round) {
    CollectLacks(values, gains, &of_photo);
    double sum = 0;
    int64_t count = 0;
    for (int i = 0; i < num_photos; ++i) {
      if (of_photo[i].size() < kMinPlaces) continue;
      gains[i] = UpperMedian(of_photo[i]);
      sum += gains[i];
      ++count;
    }
    for (int i = 0; i < num_photos && count > 0; ++i) {
      if (of_photo[i].size() >= kMinPlaces) gains[i] -= static_cast<float>(sum / static_cast<double>(count));
    }
  }
  return gains;
}

// The strength of each photo's detail beside that of its places' photos; empty lists have none.
std::vector<std::vector<float>> DetailRatios(const std::vector<ToneSample>& samples, int num_photos) {
  std::vector<std::vector<float>> ratios(num_photos);
  for (size_t begin = 0; begin < samples.size();) {
    size_t end = begin;
    float mean = 0;
    const auto detail = [&](size_t i) {
      float sum = 0;
      for (int c = 0; c < 3; ++c) {
        sum += std::abs(static_cast<float>(samples[i].sample.color[c]) -
                        static_cast<float>(samples[i].sample.smooth[c]));
      }
      return sum;
    };
    while (end < samples.size() && samples[end].place == samples[begin].place) mean += detail(end++);
    mean /= static_cast<float>(end - begin);
    for (size_t i = begin; i < end && mean > 0 && end - begin >= 2; ++i) {
      ratios[samples[i].photo].push_back(detail(i) / mean);
    }
    begin = end;
  }
  return ratios;
}

}  // namespace

std::vector<PhotoTone> EstimateTones(const std::vector<ToneSample>& samples, int num_photos,
                                     int num_threads) {
  std::vector<PhotoTone> tones(num_photos);
  if (samples.empty()) return tones;
  const size_t num_places = samples.back().place + size_t{1};
  std::vector<int> num_seen(num_places, 0);
  for (const ToneSample& s : samples) ++num_seen[s.place];
  ParallelFor(3, num_threads, [&](int64_t channel) {
    const auto c = static_cast<int>(channel);
    const std::vector<float> gains = FindGains(ChannelValues(samples, num_seen, c), num_photos);
    for (int i = 0; i < num_photos; ++i) tones[i].gain[c] = std::exp(gains[i]);
  });
  const std::vector<std::vector<float>> ratios = DetailRatios(samples, num_photos);
  for (int i = 0; i < num_photos; ++i) {
    if (ratios[i].size() >= kMinPlaces)
      tones[i].sharpness = std::max(kLeastSharpness, UpperMedian(ratios[i]));
  }
  return tones;
}

}  // namespace s2gs
