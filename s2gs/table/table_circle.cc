#include "s2gs/table/table_circle.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <functional>
#include <limits>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/binomial_tail.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

constexpr int kDirections = 36;    // so few that neighbours see different pieces of an edge.
constexpr double kMinShare = 0.6;  // the sides of a square are less.
constexpr double kMaxFalseAlarms = 1e-3;
// Ground of the table's colour behind it leaves the near half of a rim and a little more. So few directions
// count where there is no other circle and chance hardly makes one: a debt, chosen between what outlines of
// other forms and a side's lower end come to with noise (6e-7, 1e-4) and two such rims (1e-21, 1e-25).
constexpr double kLeastShare = 0.5;
constexpr double kFewestFalseAlarms = 1e-14;
constexpr double kFartherOut =
    1.25;                           // a ring on the table, or a round foot that stands on it, is further in.
constexpr double kMinFacing = 0.5;  // cosine between a direction and that to the camera: its side is seen.
constexpr double kSideReach = 0.5;  // below the top, in radii.
constexpr double kStep = 0.5;       // [px], between circles that are tried
// Neighbouring directions are further apart than one edge reaches.
constexpr double kFirst = kDirections * kEdgeApartPx / (2 * kPi);  // [px]
constexpr int kFirstOfSide = 6;                                    // [steps], beyond the rim's own edge
constexpr double kClimb = 1;                                       // [px], between heights that are tried
constexpr int kSameEnd = 4;  // [steps], either way: a pixel where the side is seen from above
constexpr int kMaxRings = 2000;
constexpr int kMaxHeights = 1000;
constexpr int kFiner = 4;                     // parts of a pixel in which an edge is placed.
constexpr double kLeastSigma = 1.0 / kFiner;  // [px]
constexpr int kPlaceRounds = 5;
constexpr double kLeastTold = 1e-6;  // of radius and height by themselves.

constexpr double kArc = 2 * kPi / kDirections;  // of one direction

struct FoundRing {
  int step = 0;
  double share = 0;
  double false_alarms = 1;
  EdgeKind kind;  // of which it was found

  bool IsMostOfACircle() const { return share > kMinShare; }
};

// Of a side.
struct FoundEnd {
  int step = 0;  // below the rim
  double false_alarms = 1;
};

// What lies about the place of a ring of a step: of (picture, direction, step).
struct RingPlace {
  bool is_hidden = false;  // by the thing
  bool is_far = false;     // beyond the axis
};
using PlaceOf = std::function<RingPlace(size_t, size_t, int)>;

// The share of the edges in what is seen and not hidden by the thing. Nothing where less than half of the
// lines tell it, or of those on the far side, or where these do not mostly have edges, as on the lower end of
// a side.
std::optional<double> ShareNotHidden(const std::vector<PictureRings>& rings, int num_lines, int s,
                                     const EdgeKind& kind, const PlaceOf& place_of) {
  PictureRings::Ring told;
  PictureRings::Ring far;
  int far_lines = 0;
  for (size_t i = 0; i < rings.size(); ++i) {
    const size_t of_picture = static_cast<size_t>(num_lines) / rings.size();
    for (size_t d = 0; d < of_picture; ++d) {
      const PictureRings::Ring line = rings[i].OfLine(d, s, kind);
      const RingPlace place = place_of(i, d, s);
      far_lines += place.is_far ? 1 : 0;
      if (line.seen == 0 || (line.edges == 0 && place.is_hidden)) continue;
      ++told.seen;
      told.edges += line.edges;
      far.seen += place.is_far ? 1 : 0;
      far.edges += place.is_far ? line.edges : 0;
    }
  }
  if (2 * told.seen < num_lines || 2 * far.seen < far_lines || !(2 * far.edges > far.seen))
    return std::nullopt;
  return static_cast<double>(told.edges) / told.seen;
}

// The ring of a step, by edges of this kind. Nothing where it is no circle's.
// \param rings  of each picture. \param num_lines  of all. \param num_tried  circles, of which this is one.
std::optional<FoundRing> RingAt(const std::vector<PictureRings>& rings, int num_lines, int s,
                                const EdgeKind& kind, double num_tried, const PlaceOf& place_of) {
  PictureRings::Ring sum;
  for (const PictureRings& of_picture : rings) {
    const PictureRings::Ring ring = of_picture.At(s, kind);
    sum.seen += ring.seen;
    sum.edges += ring.edges;
  }
  double share = sum.seen > 0 ? static_cast<double>(sum.edges) / sum.seen : 0;
  // A thing hides a half at most.
  if (2 * sum.seen < num_lines || !(2 * share > kMinShare)) return std::nullopt;
  double expected = 0;
  for (const PictureRings& of_picture : rings)
    expected += of_picture.At(s, kind).seen * of_picture.ChanceBeyond(s, kind);
  const double false_alarms = num_tried * BinomialTail(sum.edges, sum.seen, expected / sum.seen);
  if (!(false_alarms < kMaxFalseAlarms)) return std::nullopt;
  // Chance counts what is hidden, too: an edge there, of the thing, lies as likely on any other circle.
  if (!(share > kMinShare))
    share = std::max(share, ShareNotHidden(rings, num_lines, s, kind, place_of).value_or(0));
  const FoundRing found{s, share, false_alarms, kind};
  const bool is_half = share > kLeastShare && false_alarms < kFewestFalseAlarms;
  return found.IsMostOfACircle() || is_half ? std::optional<FoundRing>(found) : std::nullopt;
}

// \param rings      of each picture.
// \param num_lines  of all. \param first  that is looked at.
// \param num_tried  circles, of which this is one family.
std::vector<FoundRing> FindRings(const std::vector<PictureRings>& rings, int num_lines, int first,
                                 int num_rings, double num_tried, const PlaceOf& place_of) {
  std::vector<FoundRing> found;
  for (int s = first; s < num_rings; ++s) {
    // By light alone, too: ground of many colours has edges of tint anywhere.
    const std::array<EdgeKind, 4> kinds = {{{1, false}, {1, true}, {kColorWays, false}, {kColorWays, true}}};
    for (const EdgeKind& kind : kinds) {
      const std::optional<FoundRing> ring =
          RingAt(rings, num_lines, s, kind, static_cast<double>(kinds.size()) * num_tried, place_of);
      if (ring) found.push_back(*ring);
    }
  }
  return found;
}

// Of the frame about the axis.
struct AxisFrame {
  explicit AxisFrame(const TurntableAxis& axis) : point(axis.point), up(axis.direction) {
    Eigen::Vector3d::Index least = 0;
    up.cwiseAbs().minCoeff(&least);
    x = up.cross(Eigen::Vector3d::Unit(least)).normalized();
    y = up.cross(x);
  }
  // \param direction  of kDirections, or between two.
  Eigen::Vector3d Outwards(double direction) const {
    const double angle = kArc * direction;
    return std::cos(angle) * x + std::sin(angle) * y;
  }
  Eigen::Vector3d point, up, x, y;
};

// What one pixel of the picture is at the axis.
double PixelAt(const StillPicture& picture, const Eigen::Vector3d& x) {
  return (picture.view.cam_from_world * x).z() / std::max(picture.view.fx, picture.view.fy);
}

class CircleFinder {
 public:
  CircleFinder(const std::vector<StillPicture>& pictures, const CircleSearch& search)
      : pictures_(pictures), search_(search), frame_(search.axis) {
    const Eigen::Vector3d middle = frame_.point + (search.low + search.high) / 2 * frame_.up;
    for (const StillPicture& picture : pictures) {
      const double pixel = PixelAt(picture, middle);
      if (pixel > 0) step_ = std::min(step_, kStep * pixel);
    }
    if (!std::isfinite(step_)) return;
    climb_ = std::max(kClimb / kStep * step_, (search.high - search.low) / kMaxHeights);
    num_rings_ = static_cast<int>(std::min<double>(search.max_radius / step_, kMaxRings));
    num_steps_ = PictureRings::NumSteps(num_rings_);
    num_heights_ = static_cast<int>((search.high - search.low) / climb_) + 1;
  }

  std::optional<TableCircle> Find() {
    if (num_rings_ <= FirstStep() || pictures_.empty()) return std::nullopt;
    std::vector<std::vector<FoundRing>> found(num_heights_);
    ParallelFor(num_heights_, 0, [&](int64_t h) {
      const double height = HeightAt(static_cast<int>(h));
      found[h] = FindRings(Look(TopLines(height)), kDirections * static_cast<int>(pictures_.size()),
                           FirstStep(), num_rings_, static_cast<double>(num_heights_) * num_rings_,
                           [this, height](size_t picture, size_t direction, int s) {
                             return PlaceAt(pictures_[picture], height, (s + 0.5) * step_,
                                            static_cast<double>(direction));
                           });
    });
    const bool is_any_most = std::any_of(found.begin(), found.end(), [](const std::vector<FoundRing>& rings) {
      return std::any_of(rings.begin(), rings.end(),
                         [](const FoundRing& ring) { return ring.IsMostOfACircle(); });
    });
    std::optional<FoundRing> best;
    int best_height = 0;
    for (double least_radius = 0;;) {
      std::optional<FoundRing> clearest;
      for (int h = 0; h < num_heights_; ++h) {
        for (const FoundRing& ring : found[h]) {
          if (is_any_most && !ring.IsMostOfACircle()) continue;
          if (ring.step < least_radius || (clearest && ring.false_alarms >= clearest->false_alarms)) continue;
          clearest = ring;
          best_height = h;
        }
      }
      if (!clearest) break;
      best = clearest;
      least_radius = kFartherOut * (clearest->step + 0.5);
    }
    if (!best) return std::nullopt;
    TableCircle circle;
    circle.share = best->share;
    circle.false_alarms = best->false_alarms;
    Place(HeightAt(best_height), (best->step + 0.5) * step_, best->kind, &circle);
    circle.side_end = SideEnd(circle);
    return circle;
  }

 private:
  static int FirstStep() { return static_cast<int>(kFirst / kStep); }
  double HeightAt(int h) const { return search_.low + h * climb_; }

  // The lines of a direction's arc. \param line  (outwards), the line of one place of it.
  template <typename LineOf>
  ArcLines Bundle(double direction, const LineOf& line) const {
    ArcLines lines;
    for (int i = 0; i < kLinesOfArc; ++i)
      lines[i] = line(frame_.Outwards(direction + (i - (kLinesOfArc - 1) / 2.0) / kLinesOfArc));
    return lines;
  }

  // \param height  along the axis. \param radius  from where on.
  ArcLines TopLine(double direction, double height, double radius) const {
    return Bundle(direction, [&](const Eigen::Vector3d& outwards) {
      return SurfaceLine{frame_.point + height * frame_.up + radius * outwards, step_ * outwards};
    });
  }

  std::vector<std::vector<ArcLines>> TopLines(double height) const {
    std::vector<ArcLines> lines;
    lines.reserve(kDirections);
    for (int d = 0; d < kDirections; ++d) lines.push_back(TopLine(d, height, 0));
    return std::vector<std::vector<ArcLines>>(pictures_.size(), lines);
  }

  // \param lines  by picture.
  std::vector<PictureRings> Look(const std::vector<std::vector<ArcLines>>& lines) const {
    std::vector<PictureRings> rings;
    for (size_t i = 0; i < pictures_.size(); ++i) rings.emplace_back(pictures_[i], lines[i], num_steps_);
    return rings;
  }

  RingPlace PlaceAt(const StillPicture& picture, double height, double radius, double direction) const {
    const Eigen::Vector3d outwards = frame_.Outwards(direction);
    const Eigen::Vector3d place = height * frame_.up + radius * outwards;
    const Eigen::Vector3d to_camera =
        picture.view.cam_from_world.Inverse().translation - frame_.point - place;
    const double rise = to_camera.dot(frame_.up);
    RingPlace found;
    found.is_far = to_camera.dot(outwards) + radius < 0;
    found.is_hidden = std::any_of(search_.thing.begin(), search_.thing.end(), [&](const ThingRing& ring) {
      const double part = (ring.height - height) / rise;
      const Eigen::Vector3d x = place + part * to_camera;
      return part > 0 && part < 1 && (x - x.dot(frame_.up) * frame_.up).norm() < ring.radius;
    });
    return found;
  }

  // What a direction tells of where a circle lies, in its picture, at right angles to the circle there.
  struct Told {
    Eigen::Vector2d moved;  // [px] by a unit of radius and of height.
    double offset = 0;      // [px], of the edge.
  };

  // Where about a circle of the search the edges lie, to a part of a pixel. Pictures tell places to a part of
  // a pixel: from a low camera much more of the radius and of the height together beside the axis than before
  // and behind it. Some edges are not the circle's, so that those count less that lie off the others'.
  void Place(double height, double radius, const EdgeKind& kind, TableCircle* circle) const {
    circle->height = height;
    circle->radius = radius;
    const std::vector<PictureRings> rings = Look(TopLines(height));
    const int ring = std::min(num_steps_ - 1, static_cast<int>(radius / step_));
    for (int round = 0; round < kPlaceRounds; ++round) {
      std::vector<Told> told;
      for (size_t i = 0; i < pictures_.size(); ++i) {
        const StillPicture& picture = pictures_[i];
        for (int d = 0; d < kDirections; ++d) {
          const Eigen::Vector3d outwards = frame_.Outwards(d);
          const Eigen::Vector3d x = frame_.point + circle->height * frame_.up + circle->radius * outwards;
          const std::optional<double> offset =
              EdgeOffset(picture, TopLine(d, circle->height, circle->radius),
                         rings[i].Threshold(static_cast<size_t>(d), ring, kind), kind.num_ways);
          if (!offset) continue;
          const Eigen::Vector2d moved = MovesOfEdge(picture, x, outwards);
          told.push_back({moved, *offset * moved[0]});
        }
      }
      const std::optional<Eigen::Vector2d> change = MostTold(told);
      if (!change) return;
      circle->radius += (*change)[0];
      circle->height += (*change)[1];
    }
  }

  // The change of radius and height that edges tell; nothing where they do not tell both.
  static std::optional<Eigen::Vector2d> MostTold(const std::vector<Told>& told) {
    Eigen::Vector2d change = Eigen::Vector2d::Zero();
    for (int round = 0; round < kPlaceRounds; ++round) {
      std::vector<double> left;
      left.reserve(told.size());
      for (const Told& of : told) left.push_back(std::abs(of.offset - of.moved.dot(change)));
      if (left.empty()) return std::nullopt;
      const double sigma = std::max(kLeastSigma, kSigmaOfMad * UpperMedian(left));
      Eigen::Matrix2d normal = Eigen::Matrix2d::Zero();
      Eigen::Vector2d right = Eigen::Vector2d::Zero();
      for (size_t i = 0; i < told.size(); ++i) {
        const double weight = 1 / (1 + std::pow(left[i] / sigma, 2));
        normal += weight * told[i].moved * told[i].moved.transpose();
        right += weight * told[i].offset * told[i].moved;
      }
      if (!(normal.determinant() > kLeastTold * normal(0, 0) * normal(1, 1))) return std::nullopt;
      change = normal.ldlt().solve(right);
    }
    return change;
  }

  // How far outwards the edge next to a place lies: the middle between where it falls to half on either side.
  // Nothing where there is none within kEdgeApartPx. \param thresholds  of the changes that are an edge.
  // \param num_ways  the first, in which one is looked for.
  std::optional<double> EdgeOffset(const StillPicture& picture, const ArcLines& lines,
                                   const ColorChange& thresholds, int num_ways) const {
    const SeenArc arc(picture, lines);
    const std::optional<SeenArc::Crossing> here = arc.At(0);
    if (!here) return std::nullopt;
    const double unit = 1 / here->pitch / kFiner;  // [steps], a part of a pixel
    const int reach = static_cast<int>(2 * kEdgeApartPx * kFiner);
    std::array<std::vector<float>, kColorWays> all;
    for (int i = -reach; i <= reach; ++i) {
      const std::optional<SeenArc::Crossing> crossing = arc.At(i * unit);
      if (!crossing) return std::nullopt;
      for (int k = 0; k < kColorWays; ++k) all[k].push_back(crossing->change[k] / thresholds[k]);
    }
    const auto most_near = [&](const std::vector<float>& changes) {
      const auto near = changes.begin() + reach / 2;
      return std::max_element(near, near + reach + 1);
    };
    const std::vector<float>& changes =
        *std::max_element(all.begin(), all.begin() + num_ways,
                          [&](const auto& a, const auto& b) { return *most_near(a) < *most_near(b); });
    const auto best = static_cast<int>(most_near(changes) - changes.begin());
    int first = best;
    int last = best;
    while (first > 0 && 2 * changes[first] > changes[best]) --first;
    while (last < 2 * reach && 2 * changes[last] > changes[best]) ++last;
    if (!(changes[best] > 1) || first == 0 || last == 2 * reach) return std::nullopt;
    return ((first + last) / 2.0 - reach) * unit * step_;
  }

  // How far the circle's picture moves across itself for a unit of radius and of height [px]: edges show
  // movements across them alone.
  Eigen::Vector2d MovesOfEdge(const StillPicture& picture, const Eigen::Vector3d& x,
                              const Eigen::Vector3d& outwards) const {
    const auto pixel = [&](const Eigen::Vector3d& place) -> Eigen::Vector2d {
      const Eigen::Vector3d in_camera = picture.view.cam_from_world * place;
      return {picture.view.fx * in_camera.x() / in_camera.z(),
              picture.view.fy * in_camera.y() / in_camera.z()};
    };
    const Eigen::Vector2d along = pixel(x + step_ * outwards) - pixel(x);
    const Eigen::Vector2d up = pixel(x + step_ * frame_.up) - pixel(x);
    const Eigen::Vector3d around = frame_.up.cross(outwards);
    const Eigen::Vector2d tangent = pixel(x + step_ * around) - pixel(x);
    const Eigen::Vector2d across = Eigen::Vector2d(-tangent.y(), tangent.x()).normalized();
    return {along.dot(across) / step_, up.dot(across) / step_};
  }

  std::optional<double> SideEnd(const TableCircle& circle) const {
    const int num_rings = static_cast<int>(kSideReach * circle.radius / step_);
    const int num_steps = PictureRings::NumSteps(num_rings);
    const Eigen::Vector3d middle = frame_.point + circle.height * frame_.up;
    std::vector<PictureRings> rings;
    for (const StillPicture& picture : pictures_) {
      const Eigen::Vector3d to_camera = picture.view.cam_from_world.Inverse().translation - middle;
      const Eigen::Vector3d level = to_camera - to_camera.dot(frame_.up) * frame_.up;
      std::vector<ArcLines> lines;
      lines.reserve(kDirections);
      for (int d = 0; d < kDirections; ++d) {
        if (!(frame_.Outwards(d).dot(level) > kMinFacing * level.norm())) continue;
        lines.push_back(Bundle(d, [&](const Eigen::Vector3d& outwards) {
          return SurfaceLine{middle + circle.radius * outwards, -step_ * frame_.up};
        }));
      }
      rings.emplace_back(picture, lines, num_steps);
    }
    // The rim itself is most of what a picture shows of a narrow side: the top tells what is no edge.
    const std::vector<PictureRings> top = Look(TopLines(circle.height));
    const int rim = std::min(num_steps_ - 1, static_cast<int>(circle.radius / step_));
    std::optional<FoundEnd> clearest;
    // As rims are looked for, by light alone, too. A camera far above the table hardly sees its side, so that
    // each is asked by itself, too.
    const std::array<int, 2> ways = {1, kColorWays};
    const size_t num_groups = rings.size() > 1 ? rings.size() + 1 : 1;
    const double num_tried = static_cast<double>(ways.size() * num_groups) * num_rings;
    for (const int num_ways : ways) {
      std::vector<int> of_all;
      const auto look_at = [&](std::vector<int> ends) {
        const std::optional<FoundEnd> end = MostCommonEnd(std::move(ends), num_rings, num_tried);
        if (end && (!clearest || end->false_alarms < clearest->false_alarms)) clearest = end;
      };
      for (size_t i = 0; i < rings.size(); ++i) {
        std::vector<int> ends =
            rings[i].FirstEdges(kFirstOfSide, top[i].Threshold(0, rim, {num_ways, false}), num_ways);
        of_all.insert(of_all.end(), ends.begin(), ends.end());
        if (num_groups > 1) look_at(std::move(ends));
      }
      look_at(std::move(of_all));
    }
    if (!clearest) return std::nullopt;
    return circle.height - (clearest->step + 0.5) * step_;
  }

  // Of where lines down the side end: the place that most share, if more than half and than chance do. That
  // it is a circle is known from the rim. \param num_tried  places, of which this is one.
  static std::optional<FoundEnd> MostCommonEnd(std::vector<int> ends, int num_rings, double num_tried) {
    std::sort(ends.begin(), ends.end());
    const auto count = static_cast<int>(ends.size());
    int most = 0;
    int first = 0;
    for (int i = 0; i < count && ends[i] < num_rings; ++i) {
      const auto beyond = std::upper_bound(ends.begin(), ends.end(), ends[i] + 2 * kSameEnd);
      const auto same = static_cast<int>(beyond - ends.begin()) - i;
      if (same > most) first = i;
      most = std::max(most, same);
    }
    const double chance = (2.0 * kSameEnd + 1) / std::max(1, num_rings - kFirstOfSide);
    const double false_alarms = num_tried * BinomialTail(most, count, chance);
    if (!(2 * most > count) || !(false_alarms < kMaxFalseAlarms)) return std::nullopt;
    return FoundEnd{ends[first + most / 2], false_alarms};
  }

  const std::vector<StillPicture>& pictures_;
  const CircleSearch& search_;
  AxisFrame frame_;
  double step_ = std::numeric_limits<double>::infinity();
  double climb_ = 0;  // from height to height
  int num_rings_ = 0;
  int num_steps_ = 0;  // on to beyond the last ring
  int num_heights_ = 0;
};

}  // namespace

std::optional<TableCircle> FindTableCircle(const std::vector<StillPicture>& pictures,
                                           const CircleSearch& search) {
  return CircleFinder(pictures, search).Find();
}

}  // namespace s2gs
