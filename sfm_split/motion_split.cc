#include "sfm_split/motion_split.h"

#include <algorithm>
#include <array>
#include <map>
#include <numeric>
#include <set>
#include <utility>

namespace s2gs {
namespace {

using IndexPair = std::pair<int, int>;

IndexPair Ordered(int a, int b) { return a < b ? IndexPair(a, b) : IndexPair(b, a); }

class Splitter {
 public:
  Splitter(const std::vector<SplitImage>& images, const StationOptions& station_options,
           const DescriptorMatchOptions& match_options, const TwoViewMotionOptions& motion_options,
           const MotionSplitOptions& options, Reporter* reporter)
      : images_(images),
        station_options_(station_options),
        motion_options_(motion_options),
        options_(options),
        reporter_(*reporter),
        matcher_(match_options) {}

  MotionSplit Run() {
    for (const SplitImage& image : images_) {
      keypoints_.push_back(image.keypoints);
      sizes_.push_back(image.size);
    }
    FindStationsFromNeighbours();
    LabelStaticKeypoints();
    MatchBackgroundAcrossStations();
    MatchObjectInsideStations();
    MatchObjectAcrossStations();
    LabelRotatingKeypoints();
    return std::move(split_);
  }

 private:
  // Matches all `pairs` of `packed` images, in blocks so that progress shows and a stop is heard.
  std::vector<ImagePairMatches> MatchPairs(const std::vector<IndexPair>& pairs,
                                           const std::vector<PackedDescriptors>& packed, const char* task) {
    constexpr size_t kBlock = 32;
    std::vector<ImagePairMatches> result;
    result.reserve(pairs.size());
    std::vector<DescriptorMatcher::Job> jobs;
    std::vector<FeatureMatches> matches;
    for (size_t begin = 0; begin < pairs.size(); begin += kBlock) {
      if (reporter_.StopRequested()) throw Interrupted();
      reporter_.Progress(task, static_cast<int64_t>(begin), static_cast<int64_t>(pairs.size()));
      const size_t end = std::min(begin + kBlock, pairs.size());
      jobs.clear();
      for (size_t p = begin; p < end; ++p)
        jobs.push_back({&packed[pairs[p].first], &packed[pairs[p].second]});
      matcher_.MatchAll(jobs, &matches);
      for (size_t p = begin; p < end; ++p) {
        result.push_back({pairs[p].first, pairs[p].second, std::move(matches[p - begin])});
      }
    }
    reporter_.Progress(task, static_cast<int64_t>(pairs.size()), static_cast<int64_t>(pairs.size()));
    split_.num_pairs_matched += static_cast<int64_t>(pairs.size());
    return result;
  }

  void FindStationsFromNeighbours() {
    packed_.clear();
    for (const SplitImage& image : images_) {
      packed_.emplace_back(image.descriptors.data(), image.keypoints.size());
    }
    std::vector<IndexPair> pairs;
    for (int i = 0; i + 1 < NumImages(); ++i) pairs.emplace_back(i, i + 1);
    const auto matched = MatchPairs(pairs, packed_, "match neighbours");
    split_.stations = FindStations(keypoints_, sizes_, matched, station_options_);
    reporter_.Info(std::to_string(split_.stations.images.size()) + " stations");
  }

  // Partners spread evenly over the station: neighbours would call the points near the axis unmoved.
  void LabelStaticKeypoints() {
    std::set<IndexPair> pairs;
    for (const std::vector<int>& station : split_.stations.images) {
      const int n = static_cast<int>(station.size());
      for (int k = 1; k <= 4; ++k) {
        const int offset = (k * n + 4) / 8;
        if (offset == 0) continue;
        for (int i = 0; i < n; ++i) {
          if (station[i] != station[(i + offset) % n])
            pairs.insert(Ordered(station[i], station[(i + offset) % n]));
        }
      }
    }
    const auto matched = MatchPairs({pairs.begin(), pairs.end()}, packed_, "match stations");
    packed_.clear();

    support_.resize(images_.size());
    num_partners_.assign(images_.size(), 0);
    for (size_t i = 0; i < images_.size(); ++i) support_[i].assign(images_[i].keypoints.size(), 0);
    for (const ImagePairMatches& pair : matched) {
      const UnmovedMatches unmoved = FindUnmovedMatches(keypoints_[pair.image1], keypoints_[pair.image2],
                                                        pair, sizes_[pair.image1], station_options_);
      if (!unmoved.same_station) continue;
      ++num_partners_[pair.image1];
      ++num_partners_[pair.image2];
      for (size_t m = 0; m < pair.matches.size(); ++m) {
        if (!unmoved.is_unmoved[m]) continue;
        ++support_[pair.image1][pair.matches[m].point2D_idx1];
        ++support_[pair.image2][pair.matches[m].point2D_idx2];
      }
    }

    split_.labels.resize(images_.size());
    for (size_t i = 0; i < images_.size(); ++i) {
      split_.labels[i].assign(images_[i].keypoints.size(), KeypointLabel::kUnknown);
      const int needed = std::max(1, std::min(options_.min_static_support, num_partners_[i]));
      std::vector<uint32_t> rest;
      std::vector<uint32_t> still;
      for (uint32_t k = 0; k < images_[i].keypoints.size(); ++k) {
        const bool is_static = support_[i][k] >= needed;
        if (is_static) split_.labels[i][k] = KeypointLabel::kStatic;
        (is_static ? still : rest).push_back(k);
      }
      packed_.emplace_back(images_[i].descriptors.data(), images_[i].keypoints.size(), rest);
      packed_static_.emplace_back(images_[i].descriptors.data(), images_[i].keypoints.size(), still);
    }
  }

  // The image with most background keypoints stands for its station.
  void MatchBackgroundAcrossStations() {
    for (const std::vector<int>& station : split_.stations.images) {
      split_.representative.push_back(*std::max_element(station.begin(), station.end(), [&](int a, int b) {
        return packed_static_[a].size() < packed_static_[b].size();
      }));
    }
    std::vector<IndexPair> pairs;
    for (size_t a = 0; a < split_.representative.size(); ++a) {
      for (size_t b = a + 1; b < split_.representative.size(); ++b) {
        pairs.push_back(Ordered(split_.representative[a], split_.representative[b]));
      }
    }
    const auto matched = MatchPairs(pairs, packed_static_, "match background");
    for (const ImagePairMatches& pair : matched) {
      std::vector<int> all(pair.matches.size());
      std::iota(all.begin(), all.end(), 0);
      AddIfMotion(pair, all, &split_.static_pairs);
    }
    for (const VerifiedPair& pair : split_.static_pairs) {
      const int a = StationOf(pair.image1);
      const int b = StationOf(pair.image2);
      static_F_[{a, b}] = pair.F;
      static_F_[{b, a}] = pair.F.transpose();
    }
  }

  void MatchObjectInsideStations() {
    for (int step = 1; step <= options_.max_object_steps; ++step) {
      std::set<IndexPair> pairs;
      for (const std::vector<int>& station : split_.stations.images) {
        const int n = static_cast<int>(station.size());
        if (2 * step > n) continue;
        for (int i = 0; i < n; ++i) pairs.insert(Ordered(station[i], station[(i + step) % n]));
      }
      if (pairs.empty()) break;
      if (NumVerified(AddObjectPairs({pairs.begin(), pairs.end()}, "match object in stations")) <
          0.2 * static_cast<double>(pairs.size())) {
        break;
      }
    }
  }

  void MatchObjectAcrossStations() {
    const auto& stations = split_.stations.images;
    std::set<IndexPair> probes;
    for (size_t a = 0; a < stations.size(); ++a) {
      for (size_t b = a + 1; b < stations.size(); ++b) {
        for (const int image : Probes(stations[a])) {
          for (const int other : stations[b]) probes.insert(Ordered(image, other));
        }
      }
    }
    if (probes.empty()) return;
    std::map<IndexPair, int> strength;
    const std::vector<int> inliers = AddObjectPairs({probes.begin(), probes.end()}, "find sides");
    size_t p = 0;
    for (const IndexPair& probe : probes) strength[probe] = inliers[p++];

    std::set<IndexPair> pairs;
    for (size_t a = 0; a < stations.size(); ++a) {
      for (size_t b = a + 1; b < stations.size(); ++b) {
        AddPairsAlongProbes(stations[a], stations[b], strength, &pairs);
      }
    }
    AddObjectPairs({pairs.begin(), pairs.end()}, "match object across stations");
  }

  std::vector<int> Probes(const std::vector<int>& station) const {
    std::vector<int> probes;
    const int n = static_cast<int>(station.size());
    const int count = std::min(options_.station_probes, n);
    probes.reserve(count);
    for (int k = 0; k < count; ++k) probes.push_back(station[static_cast<size_t>(k) * n / count]);
    return probes;
  }

  // Each image of station A is matched with a window around where the nearest probe's best partner, moved on
  // by as much of a turn, is in station B. Stations may differ in their number of steps.
  void AddPairsAlongProbes(const std::vector<int>& station_a, const std::vector<int>& station_b,
                           const std::map<IndexPair, int>& strength, std::set<IndexPair>* pairs) const {
    struct Found {
      int position_a, position_b;
    };
    std::vector<Found> found;
    const int na = static_cast<int>(station_a.size());
    const int nb = static_cast<int>(station_b.size());
    for (const int probe : Probes(station_a)) {
      int best = 0;
      for (int k = 0; k < nb; ++k) {
        if (strength.at(Ordered(probe, station_b[k])) > strength.at(Ordered(probe, station_b[best])))
          best = k;
      }
      if (strength.at(Ordered(probe, station_b[best])) == 0) continue;
      const auto position = std::find(station_a.begin(), station_a.end(), probe) - station_a.begin();
      found.push_back({static_cast<int>(position), best});
    }
    if (found.empty()) return;
    for (int i = 0; i < na; ++i) {
      const Found& nearest =
          *std::min_element(found.begin(), found.end(), [&](const Found& x, const Found& y) {
            return std::abs(x.position_a - i) < std::abs(y.position_a - i);
          });
      const double turned = static_cast<double>(i - nearest.position_a) / na;
      const int centre = nearest.position_b + static_cast<int>(std::lround(turned * nb));
      for (int w = -options_.station_window; w <= options_.station_window; ++w) {
        const int k = ((centre + w) % nb + nb) % nb;
        const IndexPair pair = Ordered(station_a[i], station_b[k]);
        if (strength.count(pair) == 0) pairs->insert(pair);
      }
    }
  }

  // Matches, leaves out what follows the background, fits one motion. Returns each pair's number of inliers.
  std::vector<int> AddObjectPairs(const std::vector<IndexPair>& pairs, const char* task) {
    const auto matched = MatchPairs(pairs, packed_, task);
    std::vector<VerifiedPair> verified(matched.size());
    std::vector<int> num_inliers(matched.size(), 0);
#pragma omp parallel for schedule(dynamic)
    for (size_t p = 0; p < matched.size(); ++p) {
      std::vector<VerifiedPair> one;
      AddIfMotion(matched[p], MovingMatches(matched[p]), &one);
      if (one.empty()) continue;
      num_inliers[p] = static_cast<int>(one.front().matches.size());
      verified[p] = std::move(one.front());
    }
    for (VerifiedPair& pair : verified) {
      if (!pair.matches.empty()) split_.object_pairs.push_back(std::move(pair));
    }
    return num_inliers;
  }

  std::vector<int> MovingMatches(const ImagePairMatches& pair) const {
    std::vector<int> moving;
    const int a = StationOf(pair.image1);
    const int b = StationOf(pair.image2);
    const Eigen::Vector2f shift = split_.stations.shift[pair.image2] - split_.stations.shift[pair.image1];
    const auto F = static_F_.find({a, b});
    for (size_t m = 0; m < pair.matches.size(); ++m) {
      const Eigen::Vector2f& xy1 = keypoints_[pair.image1][pair.matches[m].point2D_idx1];
      const Eigen::Vector2f& xy2 = keypoints_[pair.image2][pair.matches[m].point2D_idx2];
      const bool follows_background =
          a == b ? (xy2 - xy1 - shift).norm() <= options_.min_moved_px
                 : F != static_F_.end() && SampsonError(F->second, xy1, xy2) <= motion_options_.max_error_px;
      if (!follows_background) moving.push_back(static_cast<int>(m));
    }
    return moving;
  }

  void AddIfMotion(const ImagePairMatches& pair, const std::vector<int>& subset,
                   std::vector<VerifiedPair>* verified) const {
    const TwoViewMotion motion =
        FitMotion(keypoints_[pair.image1], keypoints_[pair.image2], pair.matches, subset, motion_options_);
    if (motion.inliers.empty()) return;
    VerifiedPair result{pair.image1, pair.image2, {}, motion.F, motion.H, motion.is_planar};
    for (const int m : motion.inliers) result.matches.push_back(pair.matches[m]);
    verified->push_back(std::move(result));
  }

  void LabelRotatingKeypoints() {
    for (const VerifiedPair& pair : split_.object_pairs) {
      for (const FeatureMatch& match : pair.matches) {
        split_.labels[pair.image1][match.point2D_idx1] = KeypointLabel::kRotating;
        split_.labels[pair.image2][match.point2D_idx2] = KeypointLabel::kRotating;
      }
    }
  }

  static int NumVerified(const std::vector<int>& num_inliers) {
    return static_cast<int>(
        std::count_if(num_inliers.begin(), num_inliers.end(), [](int count) { return count > 0; }));
  }
  int NumImages() const { return static_cast<int>(images_.size()); }
  int StationOf(int image) const { return split_.stations.station_of_image[image]; }

  const std::vector<SplitImage>& images_;
  const StationOptions& station_options_;
  const TwoViewMotionOptions& motion_options_;
  const MotionSplitOptions& options_;
  Reporter& reporter_;
  DescriptorMatcher matcher_;

  std::vector<Keypoints> keypoints_;
  std::vector<Eigen::Vector2i> sizes_;
  std::vector<PackedDescriptors> packed_;         // all, then those without a static label
  std::vector<PackedDescriptors> packed_static_;  // those with one
  std::vector<std::vector<int>> support_;         // images that show a keypoint unmoved
  std::vector<int> num_partners_;
  std::map<std::pair<int, int>, Eigen::Matrix3d> static_F_;  // between the positions of two stations
  MotionSplit split_;
};

}  // namespace

OptionCheck MotionSplitOptions::Check() const {
  const std::array<std::pair<const char*, int>, 4> positive = {{{"min_static_support", min_static_support},
                                                                {"max_object_steps", max_object_steps},
                                                                {"station_window", station_window},
                                                                {"station_probes", station_probes}}};
  for (const auto& [name, value] : positive) {
    if (value < 1) return OptionFault{name, std::to_string(value), ">= 1"};
  }
  if (!(min_moved_px > 0)) return OptionFault{"min_moved_px", std::to_string(min_moved_px), "> 0"};
  return std::nullopt;
}

MotionSplit SplitMotion(const std::vector<SplitImage>& images, const StationOptions& station_options,
                        const DescriptorMatchOptions& match_options,
                        const TwoViewMotionOptions& motion_options, const MotionSplitOptions& options,
                        Reporter* reporter) {
  return Splitter(images, station_options, match_options, motion_options, options, reporter).Run();
}

}  // namespace s2gs
