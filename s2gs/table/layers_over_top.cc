#include "s2gs/table/layers_over_top.h"

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <iterator>
#include <numeric>
#include <optional>
#include <utility>

#include "s2gs/kernel/foreground.h"
#include "s2gs/rotating_mask.h"
#include "s2gs/table/opaque_region.h"
#include "s2gs/table/still_witness.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

// A thing's Gaussians look lit in less than .01 of the photos; of a layer's half do, and in the others a
// shadow's border or a thing behind it is seen. So one photo that sees the top is worth ln(.5 / .01), one
// that does not ln(.99 / .5), a fifth of it; a single one may be chance.
constexpr int kLeastLit = 2;
constexpr int kOtherPerLit = 4;
// At its foot a thing's own dark side looks like a shadow on the top in up to a fifth of the photos: worth as
// much as one that sees something else, and one more is asked for.
constexpr int kLeastSeen = 3;
constexpr double kBehind = 3;  // [px], of a surface that hides what lies further behind it
// What stands so high over the top [radii] is a thing and no layer, but for few.
constexpr double kHigh = 0.4;
// Of what goes because a thing does not have the top's colours, this may be the thing's; what is high may
// float.
constexpr double kMaxLost = 0.25;
// The same by points, which do not. Things that kept their shape lost .05 at most, one of .22 its lower half.
constexpr double kMaxLostOfPoints = 0.1;
constexpr int kChance =
    3;  // None is chance while three are expected (one in twenty), and so are three of few.

// Of one Gaussian, by photos.
struct Votes {
  bool is_over_top = false;
  double height = 0;  // [radii]
  int lit = 0;
  int shadow = 0;
  int border = 0;
  int other = 0;

  // Whatever colours the thing has.
  bool LitRefutes() const { return lit >= kLeastLit && kOtherPerLit * lit > other + border; }
  // A thing that has other colours than the top in light and shadow: its borders are none of the lit top's.
  // In its own shadow a thing's texture fades to what looks like a border.
  bool ColorsRefute() const {
    return (lit >= kLeastLit && kOtherPerLit * lit > other) ||
           (lit + shadow >= kLeastSeen && kOtherPerLit * lit + shadow > other + border);
  }
  // By photos that show no top there.
  bool IsBorneOut() const { return other + border >= kLeastSeen; }
  bool IsJudged() const { return is_over_top && lit + shadow + border + other >= kLeastLit; }
  bool Refutes(TopEvidence evidence) const {
    return (evidence == TopEvidence::kLight && LitRefutes()) ||
           (evidence == TopEvidence::kColors && ColorsRefute());
  }
};

// Of Gaussians that photos judge, and of those among them that a rule refutes.
struct Tally {
  int high = 0;
  int high_lost = 0;
  int low = 0;
  int low_lost = 0;

  void Add(double height, bool is_lost) {
    (height > kHigh ? high : low) += 1;
    (height > kHigh ? high_lost : low_lost) += is_lost ? 1 : 0;
  }
  // Whether too many of the low that are refuted are a thing's, if it loses as large a share of them as of
  // the high. \param more  of the high, or less, than were seen to go: chance.
  bool TakesThings(int more) const {
    return static_cast<double>(high_lost + more) * low > kMaxLost * low_lost * high;
  }
  // The same by points of things, of which some are lost; nothing where so few say nothing: less than
  // kChance of them would be lost if all that is refuted were things'.
  std::optional<bool> TakesThings(const Tally& points) const {
    const double if_all_were = static_cast<double>(points.Count()) * CountLost() / std::max(1, Count());
    if (if_all_were < kChance) return std::nullopt;
    return points.CountLost() > kMaxLostOfPoints * if_all_were;
  }
  int Count() const { return high + low; }
  int CountLost() const { return high_lost + low_lost; }
};

// By the top's own light, and by other colours what that does not refute.
struct Tallies {
  Tally by_light;
  Tally by_colors;

  explicit Tallies(const std::vector<Votes>& votes) {
    for (const Votes& of : votes) {
      if (!of.IsJudged()) continue;
      by_light.Add(of.height, of.LitRefutes());
      if (!of.LitRefutes()) by_colors.Add(of.height, of.ColorsRefute());
    }
  }
};

// Shadows and borders ask for things that bear them out; the top's own light for none that speak against it.
TopEvidence ChooseEvidence(const std::vector<Votes>& votes, const std::vector<Votes>& votes_of_points) {
  const Tallies gaussians(votes);
  const Tallies points(votes_of_points);
  if (gaussians.by_light.TakesThings(points.by_light).value_or(gaussians.by_light.TakesThings(-kChance)))
    return TopEvidence::kNone;
  const Tally& by_colors = gaussians.by_colors;
  const bool takes_things =
      by_colors.TakesThings(points.by_colors).value_or(by_colors.TakesThings(kChance) || by_colors.high == 0);
  return by_colors.low_lost > 0 && !takes_things ? TopEvidence::kColors : TopEvidence::kLight;
}

// A photo of the stations.
struct Witness {
  const PinholeView* view;
  const std::vector<float>* depths;  // of all
  std::vector<TopSight> sights;
};

Votes Ask(const std::vector<Witness>& witnesses, double pixel_size, const Eigen::Vector3d& x) {
  Votes votes;
  for (const Witness& witness : witnesses) {
    const PinholeView& view = *witness.view;
    const Eigen::Vector3d x_in_cam = view.cam_from_object * x;
    const std::optional<Eigen::Vector2d> pixel = PixelOf(view, x_in_cam);
    if (!pixel ||
        !(pixel->x() >= 0 && pixel->y() >= 0 && pixel->x() < view.width && pixel->y() < view.height))
      continue;
    const size_t p = static_cast<size_t>(pixel->y()) * view.width + static_cast<size_t>(pixel->x());
    // A photo that sees the top refutes all that is before it.
    const float depth = (*witness.depths)[p];
    const bool is_hidden = depth > 0 && x_in_cam.z() > depth + kBehind * pixel_size;
    votes.lit += witness.sights[p] == TopSight::kLit ? 1 : 0;
    votes.shadow += witness.sights[p] == TopSight::kShadow ? 1 : 0;
    votes.border += witness.sights[p] == TopSight::kBorder && !is_hidden ? 1 : 0;
    votes.other += witness.sights[p] == TopSight::kOther && !is_hidden ? 1 : 0;
  }
  return votes;
}

}  // namespace

bool IsTopSeen(TopSight sight, TopEvidence evidence) {
  return evidence != TopEvidence::kNone &&
         (sight == TopSight::kLit || (sight == TopSight::kShadow && evidence == TopEvidence::kColors));
}

std::vector<uint32_t> AllBut(const std::vector<uint32_t>& left_out, size_t count) {
  std::vector<uint32_t> all(count);
  std::iota(all.begin(), all.end(), 0);
  std::vector<uint32_t> others;
  std::set_difference(all.begin(), all.end(), left_out.begin(), left_out.end(), std::back_inserter(others));
  return others;
}

std::vector<float> RotatingDepths(const PinholeView& view, Backend* backend) {
  RenderRequest request;
  request.view = view;
  request.drawn = DrawnBody::kForeground;
  request.geometry = true;
  RenderedView rendered = backend->Render(request);
  for (size_t p = 0; p < rendered.alpha.size(); ++p) {
    if (rendered.alpha[p] < kOpaque) rendered.median_depth[p] = 0;
  }
  return std::move(rendered.median_depth);
}

std::vector<std::vector<float>> RotatingDepths(const std::vector<StationPhotos>& stations, Backend* backend) {
  std::vector<std::vector<float>> depths;
  for (const StationPhotos& station : stations) {
    for (const PinholeView& view : station.views) depths.push_back(RotatingDepths(view, backend));
  }
  return depths;
}

DepthsWithout RotatingDepthsWithout(const std::vector<StationPhotos>& stations, Backend* backend) {
  return [&stations, backend, all = backend->GetState()](const std::vector<uint32_t>& gaussians) {
    if (gaussians.empty()) return RotatingDepths(stations, backend);
    backend->SetState(SelectState(all, AllBut(gaussians, all.gaussians.size())));
    std::vector<std::vector<float>> depths = RotatingDepths(stations, backend);
    backend->SetState(all);
    return depths;
  };
}

void ForgetHiddenShadows(const RotatingRegion& table, const PinholeView& view,
                         const std::vector<float>& depths, std::vector<TopSight>* sights) {
  RotatingRegion top = table;
  top.low = top.high;
  const RegionView seen(top, view);
  const double slack = kBehind * (view.cam_from_world * table.axis.point).z() / view.fx;
  for (int y = 0; y < view.height; ++y) {
    for (int x = 0; x < view.width; ++x) {
      const size_t p = static_cast<size_t>(y) * view.width + x;
      if ((*sights)[p] != TopSight::kShadow || !(depths[p] > 0)) continue;
      const std::optional<RegionHit> hit = seen.At(x, y);
      if (hit && depths[p] < hit->depth - slack) (*sights)[p] = TopSight::kElsewhere;
    }
  }
}

namespace {

// A rotating splat that is higher than the top.
struct OverTop {
  Eigen::Vector3d x = Eigen::Vector3d::Zero();
  double height = 0;  // over the top
};

std::optional<OverTop> PlaceOverTop(const Eigen::Vector3d& x, const RotatingRegion& table,
                                    double pixel_size) {
  const double height = (x - table.axis.point).dot(table.axis.direction) - table.high;
  return height > pixel_size ? std::optional<OverTop>({x, height}) : std::nullopt;
}

// By Gaussian; nothing for what does not rotate.
std::vector<std::optional<OverTop>> PlacesOverTop(const Placement& gaussians, const RotatingRegion& table,
                                                  double pixel_size) {
  std::vector<std::optional<OverTop>> places(gaussians.size());
  for (size_t i = 0; i < places.size(); ++i) {
    const float* centre = gaussians.centre.data() + 3 * i;
    const Eigen::Vector3d x(centre[0], centre[1], centre[2]);
    if (x.allFinite() && IsForeground(gaussians.foreground_logit[i]))
      places[i] = PlaceOverTop(x, table, pixel_size);
  }
  return places;
}

std::vector<std::optional<OverTop>> PlacesOverTop(const std::vector<Eigen::Vector3d>& points,
                                                  const RotatingRegion& table, double pixel_size) {
  std::vector<std::optional<OverTop>> places;
  places.reserve(points.size());
  for (const Eigen::Vector3d& x : points) places.push_back(PlaceOverTop(x, table, pixel_size));
  return places;
}

// All photos of the stations, as they are. \param look  at a photo of a station: its sights.
template <typename Look>
std::vector<Witness> Witnesses(const std::vector<StationPhotos>& stations,
                               const std::vector<std::vector<float>>& depths, const Look& look) {
  std::vector<Witness> witnesses;
  for (const StationPhotos& station : stations) {
    for (size_t i = 0; i < station.views.size(); ++i) {
      const PinholeView& view = station.views[i];
      witnesses.push_back({&view, &depths[witnesses.size()], look(station.images[i], view, station.number)});
    }
  }
  return witnesses;
}

// Of those over the table for which `is_asked` of what is known of them, by place.
void Judge(const std::vector<Witness>& witnesses, const RotatingRegion& table, double pixel_size,
           const std::vector<std::optional<OverTop>>& places,
           const std::function<bool(const Votes&)>& is_asked, std::vector<Votes>* votes) {
  constexpr int64_t kAtOnce = 1000;  // that one thread looks at
  ParallelFor(static_cast<int64_t>(places.size()), 0, kAtOnce, [&](int64_t place) {
    const std::optional<OverTop>& over = places[static_cast<size_t>(place)];
    Votes& of = (*votes)[static_cast<size_t>(place)];
    if (!over || !is_asked(of) ||
        (over->x - table.axis.point - (over->height + table.high) * table.axis.direction).norm() >
            table.radius)
      return;
    of = Ask(witnesses, pixel_size, over->x);
    of.is_over_top = true;
    of.height = over->height / table.radius;
  });
}

std::vector<Votes> Judge(const std::vector<Witness>& witnesses, const RotatingRegion& table,
                         double pixel_size, const std::vector<std::optional<OverTop>>& places) {
  std::vector<Votes> votes(places.size());
  Judge(
      witnesses, table, pixel_size, places, [](const Votes&) { return true; }, &votes);
  return votes;
}

// In ascending order.
std::vector<uint32_t> RefutedBy(TopEvidence evidence, const std::vector<Votes>& votes) {
  std::vector<uint32_t> refuted;
  for (size_t i = 0; i < votes.size(); ++i) {
    if (votes[i].Refutes(evidence)) refuted.push_back(static_cast<uint32_t>(i));
  }
  return refuted;
}

}  // namespace

LayersOverTop FindLayersOverTop(const PlainTop& top, const std::vector<StationPhotos>& stations,
                                const DepthsWithout& depths_without, const Placement& gaussians,
                                const std::vector<Eigen::Vector3d>& of_things) {
  const RotatingRegion& table = top.table();
  const std::vector<std::vector<float>> depths = depths_without({});
  std::vector<Witness> witnesses =
      Witnesses(stations, depths, [&top](const Image8& photo, const PinholeView& view, int station) {
        return top.Look(photo, view, station);
      });
  const double pixel_size = PixelAtAxis(stations, table.axis);
  const std::vector<std::optional<OverTop>> places = PlacesOverTop(gaussians, table, pixel_size);
  const std::vector<std::optional<OverTop>> points = PlacesOverTop(of_things, table, pixel_size);
  std::vector<Votes> votes = Judge(witnesses, table, pixel_size, places);
  std::vector<Votes> votes_of_points = Judge(witnesses, table, pixel_size, points);
  // What stays although each shadow is counted hides the top: no shadow on it is seen behind. That it stands
  // there is known by photos alone: neither layers hide each other nor what only they let stay.
  std::vector<uint32_t> hides_nothing = FindRotatingIn(table, pixel_size, gaussians);
  for (size_t i = 0; i < votes.size(); ++i) {
    if (votes[i].is_over_top && (!votes[i].IsBorneOut() || votes[i].ColorsRefute()))
      hides_nothing.push_back(static_cast<uint32_t>(i));
  }
  std::sort(hides_nothing.begin(), hides_nothing.end());
  hides_nothing.erase(std::unique(hides_nothing.begin(), hides_nothing.end()), hides_nothing.end());
  const auto is_in_shadow = [](const Votes& of) { return of.ColorsRefute() && !of.LitRefutes(); };
  if (std::any_of(votes.begin(), votes.end(), is_in_shadow)) {
    const std::vector<std::vector<float>> kept = depths_without(hides_nothing);
    for (size_t k = 0; k < witnesses.size(); ++k)
      ForgetHiddenShadows(table, *witnesses[k].view, kept[k], &witnesses[k].sights);
    Judge(witnesses, table, pixel_size, places, is_in_shadow, &votes);
    Judge(witnesses, table, pixel_size, points, is_in_shadow, &votes_of_points);
  }
  const TopEvidence evidence = ChooseEvidence(votes, votes_of_points);
  return {RefutedBy(evidence, votes), std::move(hides_nothing), evidence};
}

std::vector<uint32_t> FindLayersOverTexture(const TexturedTop& top,
                                            const std::vector<StationPhotos>& stations,
                                            const std::vector<std::vector<float>>& depths,
                                            const Placement& gaussians) {
  const std::vector<Witness> witnesses =
      Witnesses(stations, depths, [&top](const Image8& photo, const PinholeView& view, int /*station*/) {
        return top.Sights(photo, view);
      });
  const RotatingRegion& table = top.table();
  const double pixel_size = PixelAtAxis(stations, table.axis);
  const std::vector<Votes> votes =
      Judge(witnesses, table, pixel_size, PlacesOverTop(gaussians, table, pixel_size));
  // Points say nothing here: those of the top's own texture lie about it.
  if (Tallies(votes).by_light.TakesThings(-kChance)) return {};
  return RefutedBy(TopEvidence::kLight, votes);
}

StandingOverTop FindStandingOverTop(const RotatingRegion& table, const std::vector<StationPhotos>& stations,
                                    const std::vector<std::vector<float>>& depths, const Placement& gaussians,
                                    const std::vector<Eigen::Vector3d>& of_things) {
  std::vector<StillWitness> witnesses;
  std::vector<size_t> first_photo;
  size_t num_photos = 0;
  for (const StationPhotos& station : stations) {
    witnesses.emplace_back(station, table);
    first_photo.push_back(num_photos);
    num_photos += station.views.size();
  }
  const double pixel_size = PixelAtAxis(stations, table.axis);
  const auto is_hidden = [&](size_t witness, size_t photo, const Eigen::Vector2d& pixel, double z) {
    const auto width = static_cast<size_t>(stations[witness].views[photo].width);
    const size_t p = static_cast<size_t>(pixel.y()) * width + static_cast<size_t>(pixel.x());
    const float depth = depths[first_photo[witness] + photo][p];
    return depth > 0 && z > depth + kBehind * pixel_size;
  };
  struct Asked {
    double height = 0;  // [radii]
    bool is_judged = false;
    bool stands = false;
  };
  const auto ask = [&](const OverTop& over) {
    const StillVotes votes = AskWitnesses(witnesses, over.x, is_hidden);
    return Asked{over.height / table.radius, votes.same + votes.changes >= kLeastLit,
                 votes.tinted >= kLeastLit && votes.tinted > votes.changes};
  };
  const auto ask_all = [&](const std::vector<std::optional<OverTop>>& places) {
    std::vector<Asked> asked(places.size());
    constexpr int64_t kAtOnce = 1000;  // that one thread looks at
    ParallelFor(static_cast<int64_t>(places.size()), 0, kAtOnce, [&](int64_t place) {
      const auto i = static_cast<size_t>(place);
      if (places[i]) asked[i] = ask(*places[i]);
    });
    return asked;
  };
  const std::vector<Asked> asked = ask_all(PlacesOverTop(gaussians, table, pixel_size));
  Tally tally;
  StandingOverTop standing;
  for (size_t i = 0; i < asked.size(); ++i) {
    if (!asked[i].is_judged) continue;
    tally.Add(asked[i].height, asked[i].stands);
    if (asked[i].stands) standing.gaussians.push_back(static_cast<uint32_t>(i));
  }
  if (standing.gaussians.empty()) return standing;
  Tally points;
  for (const Asked& point : ask_all(PlacesOverTop(of_things, table, pixel_size))) {
    if (point.is_judged) points.Add(point.height, point.stands);
  }
  standing.spares_things = !tally.TakesThings(points).value_or(tally.TakesThings(kChance));
  return standing;
}

}  // namespace s2gs
