#include "sfm_split/split/passers_by.h"

#include <algorithm>

#include "sfm_split/split/change_maps.h"
#include "sfm_split/split/pair_evidence.h"

namespace s2gs {

PassersBy::PassersBy(const ScanPictures* pictures, SplitMatching* matching, const Stations* stations)
    : pictures_(pictures),
      matching_(*matching),
      stations_(*stations),
      moves_beside_(stations->station_of_image.size(), false),
      num_moving_beside_(stations->images.size(), 0) {}

bool PassersBy::IsBeside(const ImagePairMatches& pair, const FeatureMatch& match) const {
  const auto is_busy = [&](int image, uint32_t keypoint) {
    const int station = pictures_->stations.station_of_image[image];
    return IsBusy(pictures_->pictures[image], pictures_->stations.photo_from_first[image],
                  pictures_->changes.stations[station], matching_.keypoints()[image][keypoint]);
  };
  return !is_busy(pair.image1, match.point2D_idx1) && !is_busy(pair.image2, match.point2D_idx2);
}

void PassersBy::Look(const std::vector<ImagePairMatches>& pairs,
                     const std::vector<std::vector<int>>& moving) {
  if (pictures_ == nullptr) return;
  std::vector<ImagePairMatches> beside;
  for (size_t p = 0; p < pairs.size(); ++p) {
    const ImagePairMatches& pair = pairs[p];
    if (stations_.station_of_image[pair.image1] != stations_.station_of_image[pair.image2]) continue;
    if (!matching_.images()[pair.image1].given_labels.empty()) continue;  // masks name what turns
    ImagePairMatches of_pair{pair.image1, pair.image2, {}};
    for (const int m : moving[p]) {
      if (IsBeside(pair, pair.matches[m])) of_pair.matches.push_back(pair.matches[m]);
    }
    const auto least = static_cast<size_t>(matching_.settings().motion.min_inliers);
    if (of_pair.matches.size() >= least) beside.push_back(std::move(of_pair));
  }
  const auto note = [&](int image) {
    if (!moves_beside_[image]) ++num_moving_beside_[stations_.station_of_image[image]];
    moves_beside_[image] = true;
  };
  for (const VerifiedPair& pair : matching_.VerifyAll(beside, nullptr, "look for passers-by")) {
    if (pair.matches.empty() || pair.log_false_alarms > kMaxLogFalseAlarms) continue;
    note(pair.image1);
    note(pair.image2);
  }
}

bool PassersBy::WalksBy(int image) const {
  const int station = stations_.station_of_image[image];
  const auto num_photos = static_cast<int>(stations_.images[station].size());
  return moves_beside_[image] && 2 * num_moving_beside_[station] <= num_photos;
}

bool PassersBy::LeaveOut(ImagePairMatches* pair) const {
  if (!WalksBy(pair->image1) || !WalksBy(pair->image2)) return false;
  FeatureMatches& matches = pair->matches;
  const auto is_beside = [&](const FeatureMatch& match) { return IsBeside(*pair, match); };
  const auto beside = std::remove_if(matches.begin(), matches.end(), is_beside);
  const bool has_any = beside != matches.end();
  matches.erase(beside, matches.end());
  return has_any;
}

}  // namespace s2gs
