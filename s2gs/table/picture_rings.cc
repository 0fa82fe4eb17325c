#include "s2gs/table/picture_rings.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>

#include "s2gs/image/bilinear.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

constexpr double kApart = 1.5;        // [px], to either side of an edge: lenses and JPEG soften it.
constexpr double kNear = 1.01;        // [px], to an edge that is the circle's.
constexpr double kLeastPitch = 0.05;  // [px] of a step: a direction along the ray of sight shows no edge.
constexpr double kDeviations = 3;     // of a surface's own changes of colour: an edge.
constexpr double kBeyond = 1.25;   // in radii of a ring: where it is looked at what edges there are anyway,
constexpr int kFarthest = 8;       // from so many steps beyond the ring on.
constexpr size_t kLinesAbout = 9;  // one: a quarter of the turn.
constexpr int kLevels = 1024;      // of changes of colour, a quarter of a grey level each.
constexpr float kLevelsPerGrey = 4;

ColorChange ChangeOf(const std::array<float, 3>& rgb) {
  const float most = std::max({std::abs(rgb[0]), std::abs(rgb[1]), std::abs(rgb[2])});
  return {most, std::abs(rgb[0] - rgb[1]), std::abs((rgb[0] + rgb[1]) / 2 - rgb[2])};
}

int LevelOf(float change) { return std::min(kLevels - 1, static_cast<int>(change * kLevelsPerGrey)); }

}  // namespace

SeenArc::SeenArc(const StillPicture& picture, const ArcLines& lines) : picture_(picture) {
  const Rigid3& cam_from_world = picture.view.cam_from_world;
  for (int i = 0; i < kLinesOfArc; ++i)
    lines_[i] = {cam_from_world * lines[i].start, cam_from_world.rotation * lines[i].step};
}

// Nothing near the picture's border, and where a step is hardly seen.
std::optional<SeenArc::Place> SeenArc::PlaceOn(const SeenLine& line, double s) const {
  const Eigen::Vector3d x = line.start + s * line.step;
  const std::optional<Eigen::Vector2d> pixel = PixelOf(picture_.view, x);
  constexpr double kMargin = kApart + 1;
  if (!pixel ||
      !(pixel->x() > kMargin && pixel->y() > kMargin && pixel->x() < picture_.view.width - kMargin &&
        pixel->y() < picture_.view.height - kMargin)) {
    return std::nullopt;
  }
  const Eigen::Vector2d slope = (line.step.head<2>() - line.step.z() / x.z() * x.head<2>()) / x.z();
  const Place place{*pixel, {picture_.view.fx * slope.x(), picture_.view.fy * slope.y()}};
  return place.step.norm() > kLeastPitch ? std::optional<Place>(place) : std::nullopt;
}

std::optional<SeenArc::Crossing> SeenArc::At(double s) const {
  std::array<float, 3> sum = {};
  double pitch = 0;
  int seen = 0;
  for (const SeenLine& line : lines_) {
    const std::optional<Place> place = PlaceOn(line, s);
    if (!place) continue;
    const double of_line = place->step.norm();
    const Eigen::Vector2d apart = kApart / of_line * place->step;
    const std::array<float, 3> beyond = BilinearColor(picture_.image, place->pixel + apart);
    const std::array<float, 3> before = BilinearColor(picture_.image, place->pixel - apart);
    for (int c = 0; c < 3; ++c) sum[c] += beyond[c] - before[c];
    pitch += of_line;
    ++seen;
  }
  if (2 * seen < kLinesOfArc) return std::nullopt;
  for (float& of_channel : sum) of_channel /= static_cast<float>(seen);
  return Crossing{ChangeOf(sum), pitch / seen};
}

void PictureRings::OneWay::AddLine(const std::vector<float>& changes, const std::vector<double>& pitches) {
  num_steps_ = static_cast<int>(changes.size());
  ++num_lines_;
  const auto reach = [&](int s, double pixels) {
    return std::min(num_steps_, static_cast<int>(pixels / pitches[s]));
  };
  std::vector<float> edges(num_steps_, 0);
  for (int s = 0; s < num_steps_; ++s) {
    const int r = reach(s, kEdgeApartPx);
    const auto first = changes.begin() + std::max(0, s - r);
    const auto last = changes.begin() + std::min(num_steps_, s + r + 1);
    if (changes[s] >= *std::max_element(first, last)) edges[s] = changes[s];
  }
  for (int s = 0; s < num_steps_; ++s) {
    const int r = reach(s, kNear);
    const auto first = edges.begin() + std::max(0, s - r);
    const auto last = edges.begin() + std::min(num_steps_, s + r + 1);
    nearest_.push_back(changes[s] < 0 ? -1 : *std::max_element(first, last));
  }
  changes_.insert(changes_.end(), changes.begin(), changes.end());
  edges_.insert(edges_.end(), edges.begin(), edges.end());
}

void PictureRings::OneWay::FindThresholds() {
  std::vector<size_t> all(num_lines_);
  std::iota(all.begin(), all.end(), size_t{0});
  thresholds_ = ThresholdsOf(all);
  // The last line is the first's neighbour.
  const size_t count = std::min(kLinesAbout, num_lines_);
  for (size_t line = 0; line < num_lines_; ++line) {
    std::vector<size_t> about;
    for (size_t i = 0; i < count; ++i) about.push_back((line + num_lines_ + i - count / 2) % num_lines_);
    const std::vector<float> of_line = ThresholdsOf(about);
    local_thresholds_.insert(local_thresholds_.end(), of_line.begin(), of_line.end());
  }
}

// Most of what lies just within a circle on these lines is even, whatever stands further in: half of its
// changes are its own.
std::vector<float> PictureRings::OneWay::ThresholdsOf(const std::vector<size_t>& lines) const {
  std::vector<float> thresholds;
  thresholds.reserve(num_steps_);
  std::vector<int64_t> within(kLevels, 0);
  int64_t num_within = 0;
  const auto count = [&](int s, int sign) {
    for (const size_t d : lines) {
      const float change = changes_[d * num_steps_ + s];
      if (!(change >= 0)) continue;
      within[LevelOf(change)] += sign;
      num_within += sign;
    }
  };
  int first = 0;
  for (int s = 0; s < num_steps_; ++s) {
    int median = 0;
    for (int64_t below = within[0]; median + 1 < kLevels && 2 * below < num_within;)
      below += within[++median];
    const double threshold = kDeviations * kSigmaOfMad * (median + 1) / kLevelsPerGrey;
    thresholds.push_back(static_cast<float>(threshold));
    count(s, 1);
    for (; kBeyond * (first + 1) < s; ++first) count(first, -1);
  }
  return thresholds;
}

PictureRings::PictureRings(const StillPicture& picture, const std::vector<ArcLines>& lines, int num_steps)
    : num_lines_(lines.size()), num_steps_(num_steps) {
  for (const ArcLines& of_arc : lines) AddLine(picture, of_arc);
  for (OneWay& way : ways_) way.FindThresholds();
}

int PictureRings::NumSteps(int num_rings) { return static_cast<int>(kBeyond * (num_rings + kFarthest)); }

PictureRings::Ring PictureRings::At(int s, const EdgeKind& kind) const {
  Ring ring;
  for (size_t d = 0; d < num_lines_; ++d) Count(d, s, Threshold(d, s, kind), kind.num_ways, &ring);
  return ring;
}

PictureRings::Ring PictureRings::OfLine(size_t line, int s, const EdgeKind& kind) const {
  Ring ring;
  Count(line, s, Threshold(line, s, kind), kind.num_ways, &ring);
  return ring;
}

ColorChange PictureRings::Threshold(size_t line, int s, const EdgeKind& kind) const {
  ColorChange thresholds;
  for (int k = 0; k < kColorWays; ++k) thresholds[k] = ways_[k].Threshold(line, s, kind.is_local);
  return thresholds;
}

std::vector<int> PictureRings::FirstEdges(int first, const ColorChange& thresholds, int num_ways) const {
  std::vector<int> places;
  for (size_t d = 0; d < num_lines_; ++d) {
    const auto is_edge = [&](int s) {
      for (int k = 0; k < num_ways; ++k) {
        if (ways_[k].IsEdge(d, s, thresholds[k])) return true;
      }
      return false;
    };
    int s = first;
    while (s < num_steps_ && !is_edge(s)) ++s;
    places.push_back(s);
  }
  return places;
}

double PictureRings::ChanceBeyond(int s, const EdgeKind& kind) const {
  Ring beyond{1, 1};
  const int last = std::min(num_steps_, NumSteps(s));
  for (size_t d = 0; d < num_lines_; ++d) {
    const ColorChange thresholds = Threshold(d, s, kind);
    for (int t = s + kFarthest; t < last; ++t) Count(d, t, thresholds, kind.num_ways, &beyond);
  }
  return static_cast<double>(beyond.edges) / beyond.seen;
}

void PictureRings::Count(size_t line, int s, const ColorChange& thresholds, int num_ways, Ring* ring) const {
  if (!ways_[0].IsSeen(line, s)) return;
  ++ring->seen;
  for (int k = 0; k < num_ways; ++k) {
    if (!ways_[k].IsNearEdge(line, s, thresholds[k])) continue;
    ++ring->edges;
    return;
  }
}

void PictureRings::AddLine(const StillPicture& picture, const ArcLines& lines) {
  std::array<std::vector<float>, kColorWays> changes;
  changes.fill(std::vector<float>(num_steps_, -1));  // not seen
  std::vector<double> pitches(num_steps_, 1);
  const SeenArc arc(picture, lines);
  for (int s = 0; s < num_steps_; ++s) {
    const std::optional<SeenArc::Crossing> crossing = arc.At(s + 0.5);
    if (!crossing) continue;
    for (int k = 0; k < kColorWays; ++k) changes[k][s] = crossing->change[k];
    pitches[s] = crossing->pitch;
  }
  for (int k = 0; k < kColorWays; ++k) ways_[k].AddLine(changes[k], pitches);
}

}  // namespace s2gs
