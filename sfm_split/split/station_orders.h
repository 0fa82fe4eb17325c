#pragma once

#include <functional>
#include <vector>

#include "sfm_split/matching/image_similarity.h"
#include "sfm_split/split/motion_split.h"
#include "sfm_split/split/split_matching.h"

namespace s2gs {

/// That photos are compared by before they are matched in full: their largest features, and the fewest
/// matches of these of a pair that is worth it.
constexpr size_t kCoarseFeatures = 300;
constexpr uint32_t kMinCoarseMatches = 6;

/// The order in which the table turned before each station. Names hint at it; where photos that follow each
/// other by name have less in common than others, it is made from what they have in common.
class StationOrders {
 public:
  /// Both must outlive it.
  StationOrders(const Stations& stations, SplitMatching* matching)
      : stations_(stations), matching_(*matching) {}

  /// By name, else by the largest keypoints that may turn. \param may_turn  whether keypoint k of image i
  /// may.
  void Find(const std::function<bool(int, uint32_t)>& may_turn);
  /// By verified matches, which say more than a few large features; by name where that is as good.
  void Refine(const std::vector<VerifiedPair>& object_pairs);

  /// Per station: its photos as the table turned.
  const std::vector<std::vector<int>>& order() const { return order_; }
  bool IsByName(size_t station) const { return is_by_name_[station]; }
  /// Each photo with those of its station that look most like it: tables are turned to and fro, too.
  std::vector<ImagePair> SimilarPhotos() const;

 private:
  void TakeOrder(size_t s, const std::vector<uint32_t>& order);

  const Stations& stations_;
  SplitMatching& matching_;
  std::vector<std::vector<int>> order_;
  std::vector<SimilarityMatrix> similarity_;  // per station: of its photos, ascending; empty for a few
  std::vector<bool> is_by_name_;              // per station: names tell the order
};

}  // namespace s2gs
