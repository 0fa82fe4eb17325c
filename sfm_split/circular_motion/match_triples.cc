#include "sfm_split/circular_motion/match_triples.h"

#include <algorithm>
#include <map>
#include <utility>

#include "sfm_split/circular_motion/match_mixture.h"
#include "sfm_split/circular_motion/possible_matches.h"
#include "sfm_split/circular_motion/wrong_matches.h"

namespace s2gs {
namespace {

constexpr size_t kNearest = 24;  // the width that they take tells the density, to 1 / sqrt(24)
constexpr double kLeastWidthPx = kUniformWidth * kNoiseOfMiddle * kLeastSigmaPx;  // that keypoints tell

using MatchesOfPairs = std::map<std::pair<int, int>, FeatureMatches>;

MatchesOfPairs MatchesInStations(const ScanFeatures& features) {
  MatchesOfPairs matches;
  for (const ImagePairMatches& pair : AllPairs(features)) {
    if (features.images[static_cast<size_t>(pair.image1)].station !=
        features.images[static_cast<size_t>(pair.image2)].station)
      continue;
    matches[{pair.image1, pair.image2}] = PossibleObjectMatches(features, pair);
  }
  return matches;
}

// From the first photo's keypoint to the second's, in either order of the pair.
std::map<uint32_t, uint32_t> FromTo(const MatchesOfPairs& matches, int image1, int image2) {
  std::map<uint32_t, uint32_t> result;
  if (const auto given = matches.find({image1, image2}); given != matches.end()) {
    for (const FeatureMatch& match : given->second) result.emplace(match.point2D_idx1, match.point2D_idx2);
  }
  if (const auto given = matches.find({image2, image1}); given != matches.end()) {
    for (const FeatureMatch& match : given->second) result.emplace(match.point2D_idx2, match.point2D_idx1);
  }
  return result;
}

}  // namespace

std::vector<PhotoTriple> PhotoTriples(const ScanFeatures& features) {
  const MatchesOfPairs matches = MatchesInStations(features);
  std::map<int, std::vector<int>> photos_of;
  for (size_t i = 0; i < features.images.size(); ++i)
    photos_of[features.images[i].station].push_back(static_cast<int>(i));
  std::vector<PhotoTriple> triples;
  for (const auto& [station, photos] : photos_of) {
    const auto num = static_cast<int>(photos.size());
    if (num < 4) continue;  // around three, the first and the third are neighbours
    for (int p = 0; p < num; ++p) {
      PhotoTriple triple{station, {p, (p + 1) % num, (p + 2) % num}, {}, {}};
      for (size_t k = 0; k < 3; ++k) triple.images[k] = photos[static_cast<size_t>(triple.places[k])];
      const std::map<uint32_t, uint32_t> next = FromTo(matches, triple.images[1], triple.images[2]);
      for (const auto& [first, middle] : FromTo(matches, triple.images[0], triple.images[1])) {
        if (const auto last = next.find(middle); last != next.end())
          triple.matches.push_back({{first, middle, last->second}, 0});
      }
      if (!triple.matches.empty()) triples.push_back(std::move(triple));
    }
  }
  return triples;
}

std::array<Eigen::Vector2d, 3> KeypointsOf(const ScanFeatures& features, const PhotoTriple& photos,
                                           const MatchTriple& match) {
  std::array<Eigen::Vector2d, 3> xy;
  for (size_t k = 0; k < 3; ++k) {
    const ScanImage& image = features.images[static_cast<size_t>(photos.images[k])];
    xy[k] = image.keypoints[match.point2D_idx[k]].cast<double>();
  }
  return xy;
}

MiddleMove MiddleOf(const std::array<Eigen::Vector2d, 3>& xy) {
  const Eigen::Vector2d move = xy[2] - xy[0];
  const double px = move.norm();
  if (!(px > 0)) return {};
  return {px, (xy[1] - 0.5 * (xy[0] + xy[2])).dot(move) / px};
}

WrongMiddles::WrongMiddles(const std::vector<MiddleMove>& middles) {
  for (const MiddleMove& middle : middles) {
    off_px_.push_back(middle.off_px);
    off_px_.push_back(-middle.off_px);
  }
  std::sort(off_px_.begin(), off_px_.end());
}

double WrongMiddles::Chance(const MiddleMove& middle) const {
  const double even = 1 / std::max(middle.move_px, kLeastWidthPx);
  if (off_px_.size() <= kNearest) return even;
  // Those within the least width; where they are few, the nearest ones.
  const auto place = [&](double off_px) {
    return static_cast<size_t>(std::lower_bound(off_px_.begin(), off_px_.end(), off_px) - off_px_.begin());
  };
  size_t low = place(middle.off_px - 0.5 * kLeastWidthPx);
  size_t high = place(middle.off_px + 0.5 * kLeastWidthPx);
  while (high - low < kNearest) {
    const bool goes_down = low > 0 && (high == off_px_.size() ||
                                       middle.off_px - off_px_[low - 1] < off_px_[high] - middle.off_px);
    if (goes_down) {
      --low;
    } else {
      ++high;
    }
  }
  const double width = std::max(off_px_[high - 1] - off_px_[low], kLeastWidthPx);
  const double density = static_cast<double>(high - low) / (static_cast<double>(off_px_.size()) * width);
  return kEvenShare * even + (1 - kEvenShare) * density;
}

std::vector<PhotoTriple> PossibleTriples(const ScanFeatures& features) {
  std::vector<PhotoTriple> triples = PhotoTriples(features);
  std::map<int, std::vector<MiddleMove>> middles;  // by station
  for (const PhotoTriple& triple : triples) {
    for (const MatchTriple& match : triple.matches)
      middles[triple.station].push_back(MiddleOf(KeypointsOf(features, triple, match)));
  }
  std::map<int, WrongMiddles> wrong;
  for (const auto& [station, of_station] : middles) wrong.emplace(station, WrongMiddles(of_station));
  for (PhotoTriple& triple : triples) {
    for (MatchTriple& match : triple.matches)
      match.chance = wrong.at(triple.station).Chance(MiddleOf(KeypointsOf(features, triple, match)));
  }
  return triples;
}

}  // namespace s2gs
