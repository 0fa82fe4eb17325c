#include <algorithm>
#include <cmath>

#include "sfm_split/base/angles.h"
#include "tests/support/synthetic_turntable_parts.h"

namespace s2gs::synthetic {
namespace {

/// For each point (and then each watermark) its keypoint in an image, or -1.
std::vector<int> KeypointOfPoint(const SyntheticTurntable& turntable, const SyntheticImage& image) {
  const size_t num_points = turntable.points.size();
  std::vector<int> keypoint_of(num_points + static_cast<size_t>(turntable.options.num_watermarks), -1);
  for (size_t i = 0; i < image.keypoints.size(); ++i) {
    const SyntheticKeypoint& keypoint = image.keypoints[i];
    if (keypoint.point < 0) continue;
    const size_t offset = keypoint.body == SyntheticBody::kWatermark ? num_points : 0;
    keypoint_of[offset + static_cast<size_t>(keypoint.point)] = static_cast<int>(i);
  }
  return keypoint_of;
}

/// The matches of one pair while they are made.
class PairMatcher {
 public:
  PairMatcher(const SyntheticTurntable& turntable, const std::vector<std::vector<int>>& keypoint_of,
              int image1, int image2)
      : turntable_(turntable),
        keypoint_of1_(keypoint_of[static_cast<size_t>(image1)]),
        keypoint_of2_(keypoint_of[static_cast<size_t>(image2)]),
        keypoints1_(turntable.images[static_cast<size_t>(image1)].keypoints),
        keypoints2_(turntable.images[static_cast<size_t>(image2)].keypoints),
        random_(RandomFor(
            turntable.options.seed, kMatches,
            static_cast<uint64_t>(image1) * turntable.images.size() + static_cast<uint64_t>(image2))) {
    pair_.image1 = image1;
    pair_.image2 = image2;
  }

  SyntheticPair Run() {
    const SyntheticTurntableOptions& options = turntable_.options;
    AddTrueMatches();
    std::vector<SyntheticMatch>& matches = pair_.matches;
    random_.Shuffle(&matches);
    const size_t total = matches.size();
    const size_t outliers =
        static_cast<size_t>(std::lround(options.outlier_share * static_cast<double>(total)));
    std::vector<SyntheticMatch> structured = TakeStructured(
        static_cast<size_t>(std::lround(options.structured_share * static_cast<double>(outliers))), outliers);
    matches.resize(total - outliers);
    AddRandomOutliers(outliers - structured.size(), structured);
    matches.insert(matches.end(), structured.begin(), structured.end());
    AddWatermarks();
    random_.Shuffle(&matches);
    return std::move(pair_);
  }

 private:
  bool CanMatch(const SyntheticPoint& point) const {
    const Rigid3 cam1_from_body = turntable_.CamFromBody(pair_.image1, point.body);
    const Rigid3 cam2_from_body = turntable_.CamFromBody(pair_.image2, point.body);
    const Eigen::Vector3d to1 = CameraCentre(cam1_from_body) - point.x;
    const Eigen::Vector3d to2 = CameraCentre(cam2_from_body) - point.x;
    const double angle = std::atan2(to1.cross(to2).norm(), to1.dot(to2)) * 180 / kPi;
    return angle <= turntable_.options.max_view_change_deg;
  }

  void AddTrueMatches() {
    for (size_t i = 0; i < turntable_.points.size(); ++i) {
      const SyntheticPoint& point = turntable_.points[i];
      if (keypoint_of1_[i] < 0 || keypoint_of2_[i] < 0) continue;
      const bool found = random_.Uniform() < turntable_.options.match_recall;
      if (found && CanMatch(point)) {
        pair_.matches.push_back({static_cast<uint32_t>(keypoint_of1_[i]),
                                 static_cast<uint32_t>(keypoint_of2_[i]), point.body, false});
      }
    }
  }

  /// Matches points with their twins, and takes the true matches of their keypoints out (from the front of
  /// the list), of which at most `max_removed` may go.
  std::vector<SyntheticMatch> TakeStructured(size_t wanted, size_t max_removed) {
    std::vector<SyntheticMatch> candidates;
    for (size_t i = 0; i < turntable_.points.size(); ++i) {
      const int twin = turntable_.points[i].twin;
      if (twin < 0 || keypoint_of1_[i] < 0 || keypoint_of2_[static_cast<size_t>(twin)] < 0) continue;
      candidates.push_back({static_cast<uint32_t>(keypoint_of1_[i]),
                            static_cast<uint32_t>(keypoint_of2_[static_cast<size_t>(twin)]),
                            SyntheticBody::kNone, true});
    }
    random_.Shuffle(&candidates);
    std::vector<SyntheticMatch> taken;
    size_t removed = 0;
    std::vector<bool> used1(keypoints1_.size());
    std::vector<bool> used2(keypoints2_.size());
    for (const SyntheticMatch& candidate : candidates) {
      if (taken.size() == wanted) break;
      if (used1[candidate.keypoint1] || used2[candidate.keypoint2]) continue;
      const auto conflicts = [&candidate](const SyntheticMatch& match) {
        return match.keypoint1 == candidate.keypoint1 || match.keypoint2 == candidate.keypoint2;
      };
      std::vector<SyntheticMatch>& matches = pair_.matches;
      const auto lost = static_cast<size_t>(std::count_if(matches.begin(), matches.end(), conflicts));
      if (removed + lost > max_removed) continue;
      matches.erase(std::remove_if(matches.begin(), matches.end(), conflicts), matches.end());
      removed += lost;
      used1[candidate.keypoint1] = used2[candidate.keypoint2] = true;
      taken.push_back(candidate);
    }
    return taken;
  }

  /// Keypoints of one image that are in no match.
  static std::vector<uint32_t> Free(const std::vector<SyntheticKeypoint>& keypoints,
                                    const std::vector<SyntheticMatch>& matches,
                                    const std::vector<SyntheticMatch>& structured,
                                    uint32_t SyntheticMatch::*keypoint_of_match) {
    std::vector<bool> used(keypoints.size());
    for (const SyntheticMatch& match : matches) used[match.*keypoint_of_match] = true;
    for (const SyntheticMatch& match : structured) used[match.*keypoint_of_match] = true;
    std::vector<uint32_t> free;
    for (uint32_t i = 0; i < keypoints.size(); ++i) {
      if (!used[i] && keypoints[i].body != SyntheticBody::kWatermark) free.push_back(i);
    }
    return free;
  }

  bool SamePoint(uint32_t keypoint1, uint32_t keypoint2) const {
    return keypoints1_[keypoint1].point >= 0 && keypoints1_[keypoint1].point == keypoints2_[keypoint2].point;
  }

  void AddRandomOutliers(size_t count, const std::vector<SyntheticMatch>& structured) {
    std::vector<uint32_t> free1 = Free(keypoints1_, pair_.matches, structured, &SyntheticMatch::keypoint1);
    std::vector<uint32_t> free2 = Free(keypoints2_, pair_.matches, structured, &SyntheticMatch::keypoint2);
    S2GS_INVARIANT(free1.size() >= count && free2.size() >= count);
    random_.Shuffle(&free1);
    random_.Shuffle(&free2);
    for (size_t i = 0; i < count; ++i) {
      // A swap that would make a right match, here or of the earlier outlier, is passed over.
      for (size_t k = 0; SamePoint(free1[i], free2[i]) && k < free2.size(); ++k) {
        const bool breaks_other = k < count && SamePoint(free1[k], free2[i]);
        if (!SamePoint(free1[i], free2[k]) && !breaks_other) std::swap(free2[i], free2[k]);
      }
    }
    for (size_t i = 0; i < count; ++i) {
      if (SamePoint(free1[i], free2[i])) continue;  // a single keypoint that has no other to go with
      pair_.matches.push_back({free1[i], free2[i], SyntheticBody::kNone, false});
    }
  }

  void AddWatermarks() {
    for (size_t i = turntable_.points.size(); i < keypoint_of1_.size(); ++i) {
      pair_.matches.push_back({static_cast<uint32_t>(keypoint_of1_[i]),
                               static_cast<uint32_t>(keypoint_of2_[i]), SyntheticBody::kWatermark, false});
    }
  }

  const SyntheticTurntable& turntable_;
  const std::vector<int>& keypoint_of1_;
  const std::vector<int>& keypoint_of2_;
  const std::vector<SyntheticKeypoint>& keypoints1_;
  const std::vector<SyntheticKeypoint>& keypoints2_;
  RandomNumbers random_;
  SyntheticPair pair_;
};

}  // namespace

void AddMatches(SyntheticTurntable* turntable) {
  std::vector<std::vector<int>> keypoint_of;
  for (const SyntheticImage& image : turntable->images) {
    keypoint_of.push_back(KeypointOfPoint(*turntable, image));
  }
  std::vector<std::pair<int, int>> pairs = turntable->options.pairs;
  const int num_images = static_cast<int>(turntable->images.size());
  for (int i = 0; turntable->options.pairs.empty() && i < num_images; ++i) {
    for (int j = i + 1; j < num_images; ++j) pairs.emplace_back(i, j);
  }
  for (const auto& [image1, image2] : pairs) {
    turntable->pairs.push_back(PairMatcher(*turntable, keypoint_of, image1, image2).Run());
  }
}

}  // namespace s2gs::synthetic
