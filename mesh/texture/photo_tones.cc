#include "mesh/texture/photo_tones.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <utility>

#include "mesh/light/turn_light.h"
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
constexpr int64_t kPlacesPerTurn = 256;  // of a thread
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

// The values of one channel by place and by photo. Places, and then photos, are apart from each other: so
// they are divided among threads, and what comes out does not depend on how many there are.
class GainSearch {
 public:
  GainSearch(std::vector<Value> values, int num_photos, int num_threads)
      : values_(std::move(values)), num_threads_(num_threads), gains_(num_photos, 0), of_photo_(num_photos) {
    std::vector<uint32_t> counts(num_photos, 0);
    slots_.reserve(values_.size());
    for (size_t i = 0; i < values_.size(); ++i) {
      slots_.push_back(counts[values_[i].photo]++);
      if (i == 0 || values_[i].place != values_[i - 1].place) begins_.push_back(i);
    }
    begins_.push_back(values_.size());
    for (int i = 0; i < num_photos; ++i) of_photo_[i].resize(counts[i]);
  }

  // Logarithms of the photos' gains.
  std::vector<float> Find() {
    for (int round = 0; round < kRounds; ++round) {
      ParallelFor(static_cast<int64_t>(begins_.size()) - 1, num_threads_, kPlacesPerTurn,
                  [&](int64_t place) { CollectLacks(begins_[place], begins_[place + 1]); });
      ParallelFor(static_cast<int64_t>(gains_.size()), num_threads_, [&](int64_t i) {
        if (IsKnown(i)) gains_[i] = UpperMedian(of_photo_[i]);
      });
      TakeOffMean();
    }
    return gains_;
  }

 private:
  bool IsKnown(size_t photo) const { return of_photo_[photo].size() >= kMinPlaces; }

  // What the values of a place lack of its median, each to its photo's.
  void CollectLacks(size_t begin, size_t end) {
    std::vector<float> here;
    here.reserve(end - begin);
    for (size_t i = begin; i < end; ++i) here.push_back(values_[i].log + gains_[values_[i].photo]);
    std::sort(here.begin(), here.end());
    const float middle = (here[(here.size() - 1) / 2] + here[here.size() / 2]) / 2;
    for (size_t i = begin; i < end; ++i) of_photo_[values_[i].photo][slots_[i]] = middle - values_[i].log;
  }

  void TakeOffMean() {
    double sum = 0;
    int64_t count = 0;
    for (size_t i = 0; i < gains_.size(); ++i) {
      if (!IsKnown(i)) continue;
      sum += gains_[i];
      ++count;
    }
    for (size_t i = 0; i < gains_.size(); ++i) {
      if (IsKnown(i)) gains_[i] -= static_cast<float>(sum / static_cast<double>(count));
    }
  }

  std::vector<Value> values_;
  int num_threads_;
  std::vector<float> gains_;
  std::vector<std::vector<float>> of_photo_;  // what each photo's values lack
  std::vector<uint32_t> slots_;               // per value: where it stands among its photo's
  std::vector<size_t> begins_;                // of the places among the values, and the end
};

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
  std::array<std::vector<Value>, 3> of_channel;
  ParallelFor(3, num_threads,
              [&](int64_t c) { of_channel[c] = ChannelValues(samples, num_seen, static_cast<int>(c)); });
  for (int c = 0; c < 3; ++c) {
    const std::vector<float> gains = GainSearch(std::move(of_channel[c]), num_photos, num_threads).Find();
    for (int i = 0; i < num_photos; ++i) tones[i].gain[c] = std::exp(gains[i]);
  }
  const std::vector<std::vector<float>> ratios = DetailRatios(samples, num_photos);
  for (int i = 0; i < num_photos; ++i) {
    if (ratios[i].size() >= kMinPlaces)
      tones[i].sharpness = std::max(kLeastSharpness, UpperMedian(ratios[i]));
  }
  return tones;
}

}  // namespace s2gs
