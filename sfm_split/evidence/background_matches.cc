#include "sfm_split/evidence/background_matches.h"

#include <map>
#include <vector>

#include "sfm_split/evidence/match_noise.h"
#include "sfm_split/evidence/posed_matches.h"
#include "sfm_split/turntable/tied_stations.h"

namespace s2gs {

void RecordBackgroundMatches(const ScanFeatures& features, const AlignedScene& aligned, double bound_px,
                             ScanEvidence* evidence) {
  std::map<int, size_t> set_of_station;
  const std::vector<std::vector<int>> sets = SetsOfTiedStations(aligned);
  for (size_t s = 0; s < sets.size(); ++s) {
    for (const int station : sets[s]) set_of_station[station] = s;
  }
  const PosedMatches matches(features, aligned.scene, bound_px, ScanPart::kBackground);
  std::vector<double> errors;
  for (const ImagePairMatches& pair : features.static_pairs) {
    if (!matches.IsPosed(pair.image1) || !matches.IsPosed(pair.image2)) continue;
    const int one = matches.views()[static_cast<size_t>(pair.image1)]->station;
    const int two = matches.views()[static_cast<size_t>(pair.image2)]->station;
    if (one == two || set_of_station.at(one) != set_of_station.at(two)) continue;
    evidence->background_across.Add(matches.Compare(pair, pair.matches, bound_px));
    const std::vector<double> of_pair = matches.ErrorsOf(pair, pair.matches);
    errors.insert(errors.end(), of_pair.begin(), of_pair.end());
  }
  if (static_cast<int>(errors.size()) >= kLeastSupport)
    evidence->background_noise_px = FitNoise(errors, kNoiseRange * bound_px).sigma;
}

}  // namespace s2gs
