#include "sfm_split/matching/match_images.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <tuple>
#include <unordered_map>

#include "sfm_split/base/number_text.h"

namespace s2gs {
namespace {

// Packed descriptors of the images used last, within a limit of memory.
class DescriptorCache {
 public:
  DescriptorCache(const ColmapDatabase& database, size_t max_bytes)
      : database_(database), max_bytes_(max_bytes) {}

  /// Forgets images, those unused for longest first, until half of the memory is free. Addresses of the
  /// others stay valid.
  void Shrink() {
    while (num_bytes_ > max_bytes_ / 2 && !entries_.empty()) {
      const auto oldest = std::min_element(
          entries_.begin(), entries_.end(),
          [](const auto& a, const auto& b) { return a.second.last_use < b.second.last_use; });
      num_bytes_ -= oldest->second.descriptors.MemoryBytes();
      entries_.erase(oldest);
    }
  }

  const PackedDescriptors& Get(uint32_t image_id) {
    const auto [entry, is_new] = entries_.try_emplace(image_id);
    if (is_new) {
      const DescriptorMatrix descriptors = database_.ReadDescriptors(image_id);
      entry->second.descriptors =
          PackedDescriptors(descriptors.data(), static_cast<size_t>(descriptors.rows()));
      num_bytes_ += entry->second.descriptors.MemoryBytes();
      ++num_loads_;
    }
    entry->second.last_use = ++clock_;
    return entry->second.descriptors;
  }

  bool Full() const { return num_bytes_ >= max_bytes_; }
  bool Has(uint32_t image_id) const { return entries_.count(image_id) != 0; }
  size_t num_loads() const { return num_loads_; }

 private:
  struct Entry {
    PackedDescriptors descriptors;
    uint64_t last_use = 0;
  };

  const ColmapDatabase& database_;
  size_t max_bytes_;
  std::unordered_map<uint32_t, Entry> entries_;
  size_t num_bytes_ = 0;
  size_t num_loads_ = 0;
  uint64_t clock_ = 0;
};

// Orders pairs by square tiles of the table of all pairs, so that the images of a tile fit half of the cache
// and are read once a tile.
void SortByTiles(size_t images_per_tile_side, std::vector<ImagePair>* pairs) {
  const auto side = static_cast<uint32_t>(images_per_tile_side);
  std::sort(pairs->begin(), pairs->end(), [side](ImagePair a, ImagePair b) {
    return std::make_tuple(a.first / side, a.second / side, a.first, a.second) <
           std::make_tuple(b.first / side, b.second / side, b.first, b.second);
  });
}

}  // namespace

OptionCheck MatchImagesOptions::Check() const {
  if (OptionCheck fault = match.Check()) return fault;
  if (num_threads < 0) return OptionFault{"num_threads", std::to_string(num_threads), "num_threads >= 0"};
  if (!(cache_size_gb > 0.0 && cache_size_gb <= 1e6)) {
    return OptionFault{"cache_size_gb", NumberText(cache_size_gb), "0 < cache_size_gb <= 1e6"};
  }
  return std::nullopt;
}

MatchImagesSummary MatchImages(const std::vector<uint32_t>& image_ids, const std::vector<ImagePair>& pairs,
                               const MatchImagesOptions& options, ColmapDatabase* database,
                               Reporter& reporter) {
  constexpr int64_t kMultiplyAddsPerBatch = 100'000'000'000;  // about a second of one core
  constexpr size_t kPairsPerBatch = 4096;                     // between two looks at whether to stop
  S2GS_INVARIANT(!options.Check().has_value());

  MatchImagesSummary summary;
  std::vector<ImagePair> todo;
  size_t largest_image = 1;
  for (const ImagePair pair : NewPairs(pairs, {})) {
    S2GS_INVARIANT(pair.first < pair.second && pair.second < image_ids.size());
    const uint32_t image_id1 = image_ids[pair.first];
    const uint32_t image_id2 = image_ids[pair.second];
    if (database->HasMatches(image_id1, image_id2)) {
      ++summary.num_pairs_skipped;
    } else {
      todo.push_back(pair);
    }
  }
  for (const uint32_t image_id : image_ids) {
    largest_image = std::max(largest_image, static_cast<size_t>(database->NumKeypoints(image_id)));
  }
  const double cache_bytes = options.cache_size_gb * 1e9;
  const double images_in_cache = cache_bytes / (static_cast<double>(largest_image) * (kDescriptorSize + 8));
  SortByTiles(static_cast<size_t>(std::clamp(images_in_cache / 4.0, 1.0, 1e9)), &todo);

  DescriptorMatcher matcher(options.match, options.num_threads);
  DescriptorCache cache(*database, static_cast<size_t>(cache_bytes));
  std::vector<DescriptorMatcher::Job> jobs;
  std::vector<FeatureMatches> matches;
  reporter.Progress("match pairs", static_cast<int64_t>(summary.num_pairs_skipped),
                    static_cast<int64_t>(summary.num_pairs_skipped + todo.size()));
  for (size_t begin = 0; begin < todo.size();) {
    if (reporter.StopRequested()) throw Interrupted();
    if (cache.Full()) cache.Shrink();
    jobs.clear();
    int64_t work = 0;
    size_t end = begin;
    while (end < todo.size() && work < kMultiplyAddsPerBatch && end - begin < kPairsPerBatch) {
      const uint32_t image_id1 = image_ids[todo[end].first];
      const uint32_t image_id2 = image_ids[todo[end].second];
      if (end > begin && cache.Full() && !(cache.Has(image_id1) && cache.Has(image_id2))) break;
      const PackedDescriptors& image1 = cache.Get(image_id1);
      const PackedDescriptors& image2 = cache.Get(image_id2);
      jobs.push_back({&image1, &image2});
      work += static_cast<int64_t>(image1.size() * image2.size()) * kDescriptorSize;
      ++end;
    }
    matcher.MatchAll(jobs, &matches);
    database->InTransaction([&] {
      for (size_t i = begin; i < end; ++i) {
        database->WriteMatches(image_ids[todo[i].first], image_ids[todo[i].second], matches[i - begin]);
      }
    });
    for (const FeatureMatches& of_pair : matches) summary.num_matches += of_pair.size();
    summary.num_pairs_matched += end - begin;
    begin = end;
    reporter.Progress("match pairs",
                      static_cast<int64_t>(summary.num_pairs_skipped + summary.num_pairs_matched),
                      static_cast<int64_t>(summary.num_pairs_skipped + todo.size()));
  }
  summary.num_image_loads = cache.num_loads();
  return summary;
}

}  // namespace s2gs
