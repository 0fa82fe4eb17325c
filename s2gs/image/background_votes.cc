#include "s2gs/image/background_votes.h"

#include <algorithm>
#include <cmath>
#include <functional>

#include "sfm_split/base/binomial_tail.h"

namespace s2gs {
namespace {

constexpr double kMostFalseAlarms = 0.01;
constexpr int kPassersBy = 10;  // one photo in so many

}  // namespace

BackgroundRange FindBackgroundRange(std::vector<double>* differences) {
  const auto count = static_cast<int>(differences->size());
  const int passers_by = count / kPassersBy;
  std::nth_element(differences->begin(), differences->begin() + passers_by, differences->end(),
                   std::greater<>());
  return {(*differences)[passers_by], (passers_by + 1.0) / (count + 1.0)};
}

BackgroundSight Weigh(const BackgroundVotes& votes, double as_thing, int num_places) {
  if (votes.photos == 0) return BackgroundSight::kUnknown;
  const double chance = votes.chance / votes.photos;
  if (!(as_thing > chance)) return BackgroundSight::kUnknown;
  const int same = votes.photos - votes.differ;
  const double gain =
      votes.differ * std::log(as_thing / chance) + same * std::log((1 - as_thing) / (1 - chance));
  if (gain > 0 && num_places * BinomialTail(votes.differ, votes.photos, chance) < kMostFalseAlarms)
    return BackgroundSight::kThere;
  if (gain < 0 && num_places * BinomialTail(same, votes.photos, 1 - as_thing) < kMostFalseAlarms)
    return BackgroundSight::kNotThere;
  return BackgroundSight::kUnknown;
}

bool DifferBeyondChance(const BackgroundVotes& votes) {
  return votes.photos > 0 &&
         BinomialTail(votes.differ, votes.photos, votes.chance / votes.photos) < kMostFalseAlarms;
}

double ShareWhereSomethingIs(const BackgroundVotes& of_known) {
  return (of_known.differ + 1.0) / (of_known.photos + 2.0);
}

}  // namespace s2gs
