#include "sfm_split/split/station_orders.h"

#include <algorithm>
#include <numeric>

#include "sfm_split/matching/photo_order.h"

namespace s2gs {
namespace {

// Photos of a station that look most like one: its neighbours on the turn.
constexpr int kSimilarInStation = 3;

}  // namespace

void StationOrders::Find(const std::function<bool(int, uint32_t)>& may_turn) {
  const PackedImages largest =
      matching_.PackLargest(kCoarseFeatures, [&](int i, uint32_t k) { return may_turn(i, k); });
  order_ = stations_.images;
  similarity_.resize(order_.size());
  is_by_name_.assign(order_.size(), true);
  for (size_t s = 0; s < order_.size(); ++s) {
    if (order_[s].size() < 4) continue;
    PackedImages of_station;
    of_station.reserve(order_[s].size());
    for (const int i : order_[s]) of_station.push_back(largest[i]);
    similarity_[s] = CountMatchesOfAllPairs(of_station, matching_.matcher(), matching_.reporter());
    std::vector<uint32_t> by_name(order_[s].size());
    std::iota(by_name.begin(), by_name.end(), 0U);
    if (OrderAgreement(by_name, similarity_[s]) >= kMinOrderAgreement) continue;
    is_by_name_[s] = false;
    TakeOrder(s, OrderBySimilarity(similarity_[s]));
  }
}

void StationOrders::TakeOrder(size_t s, const std::vector<uint32_t>& order) {
  for (size_t p = 0; p < order.size(); ++p) order_[s][p] = stations_.images[s][order[p]];
}

void StationOrders::Refine(const std::vector<VerifiedPair>& object_pairs) {
  const std::vector<int>& station_of = stations_.station_of_image;
  for (size_t s = 0; s < order_.size(); ++s) {
    if (is_by_name_[s]) continue;
    const std::vector<int>& images = stations_.images[s];
    const auto num = static_cast<Eigen::Index>(images.size());
    SimilarityMatrix verified = SimilarityMatrix::Zero(num, num);
    for (const VerifiedPair& pair : object_pairs) {
      if (station_of[pair.image1] != static_cast<int>(s) || station_of[pair.image2] != static_cast<int>(s))
        continue;
      const auto a = std::lower_bound(images.begin(), images.end(), pair.image1) - images.begin();
      const auto b = std::lower_bound(images.begin(), images.end(), pair.image2) - images.begin();
      verified(a, b) = verified(b, a) = static_cast<uint32_t>(pair.matches.size());
    }
    std::vector<uint32_t> by_name(images.size());
    std::iota(by_name.begin(), by_name.end(), 0U);
    const std::vector<uint32_t> by_matches = OrderBySimilarity(verified);
    const bool is_named = OrderAgreement(by_name, verified) >= OrderAgreement(by_matches, verified);
    TakeOrder(s, is_named ? by_name : by_matches);
  }
}

std::vector<ImagePair> StationOrders::SimilarPhotos() const {
  std::vector<ImagePair> pairs;
  for (size_t s = 0; s < similarity_.size(); ++s) {
    if (similarity_[s].size() == 0) continue;
    const std::vector<int>& station = stations_.images[s];
    for (const ImagePair& pair : SimilarPairs(similarity_[s], kSimilarInStation)) {
      if (similarity_[s](pair.first, pair.second) >= kMinCoarseMatches)
        pairs.push_back(OrderedPair(station[pair.first], station[pair.second]));
    }
  }
  return pairs;
}

}  // namespace s2gs
