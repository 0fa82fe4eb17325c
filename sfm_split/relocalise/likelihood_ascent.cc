#include "sfm_split/relocalise/likelihood_ascent.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "sfm_split/relocalise/match_ascent.h"

namespace s2gs {
namespace {

using State = MatchAscent::State;

constexpr double kFirstSigmaPx = 4;      // a degree of a camera, where the object is a hundred pixels wide
constexpr double kSearchSigmaPx = 1;     // wide enough that climbs come from one start to the next
constexpr double kSearchStep = 1;        // of the noise; of a station's turn, as the object's points move
constexpr size_t kSearchMatches = 6000;  // of the search
constexpr size_t kSearchDecided = 3;     // of the places found, by all matches
constexpr size_t kMostSweeps = 3;        // over the stations
constexpr int kWideSteps = 4;            // at each noise that is wider than it is
constexpr int kSearchSteps = 12;         // a judgement: enough to rank places, all that are taken go on
constexpr int kNoiseRounds = 4;          // a judgement: noise and state by turns
constexpr double kSettled = 0.01;        // of a logarithm of a likelihood

// Climbs with all matches from the likeliest of some places, to which the present one belongs. Empties them.
void TakeLikeliest(const AscentNoise& noise, Reporter& reporter, MatchAscent* ascent,
                   std::vector<std::pair<double, State>>* found) {
  std::stable_sort(found->begin(), found->end(),
                   [](const auto& a, const auto& b) { return a.first > b.first; });
  double best = ascent->Value(noise);
  State likeliest = ascent->state();
  for (size_t k = 0; k < std::min(found->size(), kSearchDecided); ++k) {
    ascent->SetState((*found)[k].second);
    const double value = ascent->Climb(noise, kSearchSteps, reporter);
    if (value <= best) continue;
    best = value;
    likeliest = ascent->state();
  }
  ascent->SetState(std::move(likeliest));
  found->clear();
}

// Where matches are few, what is wrong among them is likeliest at places of its own. Some of the matches find
// the places, all of them decide.
void Search(const AscentNoise& noise, Reporter& reporter, MatchAscent* ascent) {
  MatchAscent search = *ascent;
  search.Thin(kSearchMatches);
  std::vector<std::pair<double, State>> found;
  const auto climb_from = [&](const State& from, double first_sigma_px) {
    search.SetState(from);
    for (double wide_px = first_sigma_px; wide_px > noise.object; wide_px *= 0.5)
      search.Climb(noise.Widened(wide_px), kWideSteps, reporter);
    found.emplace_back(search.Climb(noise, kSearchSteps, reporter), search.state());
  };
  for (const double first_sigma_px : {noise.object, kSearchSigmaPx, kFirstSigmaPx})
    climb_from(ascent->state(), first_sigma_px);
  TakeLikeliest(noise, reporter, ascent, &found);
  // What moves little as the table turns, light on an object without texture, has a maximum of its own, as
  // sharp as that of what turns: the whole turn is looked at, the rest held, and the best of it climbed from;
  // with wider noise as well, as cameras that stand wrong hide the sharpest one.
  // One after the other, again while that helps: where one station stands wrong, others follow it.
  const size_t num_stations = ascent->state().stations.size();
  size_t unmoved = 0;
  for (size_t k = 0; unmoved < num_stations && k < kMostSweeps * num_stations; ++k) {
    const size_t s = k % num_stations;
    const double before = ascent->Value(noise);
    for (const double wide_px : {noise.object, kSearchSigmaPx}) {
      if (wide_px < noise.object) continue;
      search.SetState(ascent->state());
      for (const double turn_rad : search.TurnsAlone(s, wide_px, kSearchStep * wide_px)) {
        State turned = ascent->state();
        turned.stations[s].turn_rad += turn_rad;
        climb_from(turned, wide_px);
      }
    }
    TakeLikeliest(noise, reporter, ascent, &found);
    unmoved = ascent->Value(noise) > before + kSettled ? 0 : unmoved + 1;
  }
}

}  // namespace

LikelihoodAscent AscendLikelihood(const ScanFeatures& features, const std::vector<PossiblePair>& object_pairs,
                                  Reporter& reporter, AlignedScene* aligned) {
  LikelihoodAscent result;
  MatchAscent ascent(features, object_pairs, *aligned);
  if (!ascent.HasStations()) return result;
  const MatchAscent start = ascent;
  AscentNoise noise{kSearchSigmaPx, kSearchSigmaPx};
  for (int k = 0; k < kNoiseRounds; ++k) noise = ascent.NoiseBy(noise);
  Search(noise, reporter, &ascent);
  noise = ascent.Settle(noise, reporter);
  result.sigma_px = noise.object;
  result.after = ascent.Value(noise);
  result.before = start.Value(noise);
  if (result.after > result.before) ascent.Apply(aligned);
  return result;
}

}  // namespace s2gs
