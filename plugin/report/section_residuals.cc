#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "plugin/report/data_uri.h"
#include "plugin/report/plot.h"
#include "plugin/report/residuals.h"
#include "plugin/report/sections.h"

namespace s2gs {
namespace {

constexpr int kBins = 40;
constexpr int kCellsAcross = 16;
constexpr double kFieldWidth = 480;     // of the drawing
constexpr size_t kMinMatrixSide = 480;  // of the picture of shared points [px]

struct Body {
  const char* name;
  const char* key;
  int color;
  const ColmapModel* model;
  ModelResiduals residuals;
  std::vector<double> lengths;  // of the residuals, sorted
};

std::vector<Body> Bodies(const ReportInput& input) {
  std::vector<Body> bodies;
  if (input.object) bodies.push_back({"rotating part", "object", 0, &*input.object, {}, {}});
  if (input.background) bodies.push_back({"background", "background", 1, &*input.background, {}, {}});
  for (Body& body : bodies) {
    body.residuals = ComputeResiduals(*body.model);
    for (const auto& [id, observations] : body.residuals.by_image) {
      for (const auto& observation : observations) body.lengths.push_back(observation.residual.norm());
    }
    std::sort(body.lengths.begin(), body.lengths.end());
  }
  return bodies;
}

double Quantile(const std::vector<double>& sorted, double share) {
  if (sorted.empty()) return std::numeric_limits<double>::quiet_NaN();
  return sorted[static_cast<size_t>(share * static_cast<double>(sorted.size() - 1))];
}

double Rms(const std::vector<double>& values) {
  double sum = 0;
  for (const double value : values) sum += value * value;
  return std::sqrt(sum / static_cast<double>(values.size()));
}

void WriteHistogram(const std::vector<Body>& bodies, ReportSection* section) {
  double limit = 0;
  for (const Body& body : bodies) {
    if (!body.lengths.empty()) limit = std::max(limit, Quantile(body.lengths, 0.99));
  }
  if (!(limit > 0)) limit = 1;
  Plot plot{"Residuals of the keypoints",
            {"length [px]; the last bar holds all beyond", false},
            {"share of the body's keypoints [%]", false},
            {},
            true};
  for (const Body& body : bodies) {
    if (body.lengths.empty()) continue;
    const std::vector<size_t> counts = Histogram(body.lengths, limit, kBins);
    PlotSeries series;
    series.name = body.name;
    series.color = body.color;
    series.mark = body.color == 0 ? PlotMark::kBars : PlotMark::kLine;
    for (int i = 0; i < kBins; ++i) {
      series.points.emplace_back((i + 0.5) * limit / kBins, 100.0 * static_cast<double>(counts[i]) /
                                                                static_cast<double>(body.lengths.size()));
    }
    section->numbers[body.key] = {{"observations", body.lengths.size()},
                                  {"behind_the_camera", body.residuals.num_behind},
                                  {"rms_px", FiniteOrNull(Rms(body.lengths))},
                                  {"median_px", FiniteOrNull(Quantile(body.lengths, 0.5))},
                                  {"p90_px", FiniteOrNull(Quantile(body.lengths, 0.9))},
                                  {"p99_px", FiniteOrNull(Quantile(body.lengths, 0.99))},
                                  {"histogram", {{"limit_px", limit}, {"counts", counts}}}};
    plot.series.push_back(std::move(series));
  }
  WritePlot(plot, &section->html);
}

void WriteTracks(const std::vector<Body>& bodies, ReportSection* section) {
  size_t longest = 0;
  for (const Body& body : bodies) {
    for (const auto& [id, point] : body.model->points3D) longest = std::max(longest, point.track.size());
  }
  Plot plot{
      "Photos that see a point", {"length of the track [photos]", longest > 30}, {"points", true}, {}, false};
  for (const Body& body : bodies) {
    std::map<size_t, size_t> counts;
    double sum = 0;
    for (const auto& [id, point] : body.model->points3D) {
      ++counts[point.track.size()];
      sum += static_cast<double>(point.track.size());
    }
    if (counts.empty()) continue;
    PlotSeries series;
    series.name = body.name;
    series.color = body.color;
    series.mark = PlotMark::kDots;
    auto& numbers = section->numbers[body.key]["track_lengths"];
    for (const auto& [length, count] : counts) {
      series.points.emplace_back(length, count);
      series.titles.push_back(
          fmt::format("{}: {} seen by {}", body.name, Count(count, "point"), Count(length, "photo")));
      numbers.push_back({length, count});
    }
    section->numbers[body.key]["points"] = body.model->points3D.size();
    section->numbers[body.key]["mean_track_length"] = sum / static_cast<double>(body.model->points3D.size());
    plot.series.push_back(std::move(series));
  }
  WritePlot(plot, &section->html);
}

// An arrow for each cell's mean residual, a dot where too few points were seen.
// \param scale  of the drawing. \param arrow  of the residuals in it.
void WriteCells(const ResidualField& field, double scale, double arrow, HtmlWriter* out) {
  for (const ResidualField::Cell& cell : field.cells) {
    const Eigen::Vector2d from = scale * cell.middle;
    if (cell.count < 10) {
      out->Void("circle", {{"class", "faint"},
                           {"cx", ShortNumber(from.x(), 1)},
                           {"cy", ShortNumber(from.y(), 1)},
                           {"r", "1.2"}});
      continue;
    }
    const Eigen::Vector2d to = from + arrow * cell.mean;
    out->Open("g", {{"class", cell.is_systematic ? "systematic" : "chance"}});
    out->Void("line", {{"x1", ShortNumber(from.x(), 1)},
                       {"y1", ShortNumber(from.y(), 1)},
                       {"x2", ShortNumber(to.x(), 1)},
                       {"y2", ShortNumber(to.y(), 1)}});
    out->Void("circle", {{"cx", ShortNumber(from.x(), 1)}, {"cy", ShortNumber(from.y(), 1)}, {"r", "1.8"}});
    out->Element("title",
                 fmt::format("{} px from {}", Significant(cell.mean.norm(), 2), Count(cell.count, "point")));
    out->Close();
  }
}

void WriteField(const std::vector<Body>& bodies, ReportSection* section) {
  std::vector<const ColmapModel*> models;
  std::vector<const ModelResiduals*> residuals;
  for (const Body& body : bodies) {
    models.push_back(body.model);
    residuals.push_back(&body.residuals);
  }
  HtmlWriter& out = section->html;
  for (const auto& [id, camera] : models.front()->cameras) {
    const ResidualField field = ComputeResidualField(models, residuals, camera, kCellsAcross);
    if (field.cells.empty() || camera.width == 0 || camera.height == 0) continue;
    double longest = 0;
    size_t systematic = 0;
    for (const ResidualField::Cell& cell : field.cells) {
      if (cell.is_systematic) ++systematic;
      if (cell.count >= 10) longest = std::max(longest, cell.mean.norm());
    }
    const double scale = kFieldWidth / static_cast<double>(std::max(camera.width, camera.height));
    const double arrow = longest > 0 ? 1.2 * field.cell_px * scale / longest : 0;
    out.Open("figure").Element("figcaption", models.front()->cameras.size() > 1
                                                 ? fmt::format("Mean residual over the frame, camera {}", id)
                                                 : "Mean residual over the frame");
    out.Open("svg",
             {{"class", "field"},
              {"viewBox", fmt::format("0 0 {} {}", ShortNumber(static_cast<double>(camera.width) * scale),
                                      ShortNumber(static_cast<double>(camera.height) * scale))},
              {"role", "img"},
              {"aria-label", "Mean residual over the frame"}});
    WriteCells(field, scale, arrow, &out);
    out.Close();
    out.Element(
        "p",
        fmt::format("The longest arrow is {} px. {} of {} cells are coloured: there the mean is larger than "
                    "chance would make it, so that something that the camera model lacks is left.",
                    Significant(longest, 2), systematic, field.cells.size()),
        {{"class", "note"}});
    out.Close();
    section->numbers["field"].push_back({{"camera_id", id},
                                         {"cells", field.cells.size()},
                                         {"systematic_cells", systematic},
                                         {"largest_mean_px", FiniteOrNull(longest)}});
  }
}

// Dark blue over green to yellow, for t from 0 to 1: even in lightness, also for the colour-blind.
void SetHeat(double t, uint8_t* rgb) {
  constexpr double kStops[5][3] = {
      {38, 32, 80}, {48, 86, 132}, {34, 140, 130}, {112, 194, 96}, {250, 230, 60}};
  const double at = std::clamp(t, 0.0, 1.0) * 4;
  const int stop = std::min(3, static_cast<int>(at));
  for (int c = 0; c < 3; ++c) {
    rgb[c] =
        static_cast<uint8_t>(kStops[stop][c] + (at - stop) * (kStops[stop + 1][c] - kStops[stop][c]) + 0.5);
  }
}

// The photos by station and table angle.
std::vector<std::string> MatrixOrder(const ReportInput& input) {
  std::vector<std::string> order;
  for (const std::string& name : input.photos) {
    if (input.ObjectImage(name) != nullptr || input.BackgroundImage(name) != nullptr) order.push_back(name);
  }
  const auto key = [&](const std::string& name) {
    const TurntableImage* image = input.TableImage(name);
    const double angle = image == nullptr ? 0 : std::fmod(image->angle_deg + 720, 360);
    return std::make_pair(input.StationOf(name), angle);
  };
  std::stable_sort(order.begin(), order.end(),
                   [&](const std::string& a, const std::string& b) { return key(a) < key(b); });
  return order;
}

void WriteMatches(const ReportInput& input, const std::vector<Body>& bodies, ReportSection* section) {
  const std::vector<std::string> order = MatrixOrder(input);
  if (order.size() < 2) return;
  const size_t n = order.size();
  Image8 picture{static_cast<int>(n), static_cast<int>(n), 3, std::vector<uint8_t>(3 * n * n, 20)};
  for (const Body& body : bodies) {
    const bool is_object = std::string(body.key) == "object";
    const auto counts = SharedPoints(*body.model, order);
    size_t pairs = 0;
    uint32_t most = 1;
    for (size_t a = 0; a < n; ++a) {
      for (size_t b = 0; b < a; ++b) {
        most = std::max(most, counts[a][b]);
        pairs += counts[a][b] > 0 ? 1 : 0;
      }
    }
    size_t alone = 0;
    for (size_t a = 0; a < n; ++a) {
      if (*std::max_element(counts[a].begin(), counts[a].end()) == 0) ++alone;
      for (size_t b = 0; b < a; ++b) {
        // The rotating part below the diagonal, the background above it.
        const int x = static_cast<int>(is_object ? b : a);
        const int y = static_cast<int>(is_object ? a : b);
        if (counts[a][b] > 0) SetHeat(std::log1p(counts[a][b]) / std::log1p(most), picture.Pixel(x, y));
      }
    }
    section->numbers[body.key]["pairs_with_shared_points"] = pairs;
    section->numbers[body.key]["most_shared_points"] = most;
    section->numbers[body.key]["photos_without_shared_points"] = alone;
  }
  HtmlWriter& out = section->html;
  out.Open("figure").Element("figcaption", "Which photos see the same points");
  const size_t zoom = std::max<size_t>(1, kMinMatrixSide / n);
  out.Void("img", {{"class", "matrix"},
                   {"src", PngDataUri(picture)},
                   {"width", std::to_string(zoom * n)},
                   {"height", std::to_string(zoom * n)},
                   {"alt", "matrix of points shared by pairs of photos"}});
  out.Element(
      "p",
      "Photos by station and table angle, from the top and from the left. Below the diagonal: points of the "
      "rotating part that both photos see; above it: of the background. Black: none; dark blue to yellow: "
      "few "
      "to many, by their logarithm. A gap in the band along the diagonal is a turn that nothing bridges.",
      {{"class", "note"}});
  out.Close();
}

}  // namespace

ReportSection ResidualsSection(const ReportInput& input) {
  ReportSection section{"residuals", "Residuals and matches", {}, {}};
  section.numbers = nlohmann::ordered_json::object();
  const std::vector<Body> bodies = Bodies(input);
  if (bodies.empty()) {
    WriteMissing("There are no sparse models yet: turntable_mapper makes them.", &section.html);
    return section;
  }
  section.html.Open("div", {{"class", "figures"}});
  WriteHistogram(bodies, &section);
  WriteTracks(bodies, &section);
  WriteField(bodies, &section);
  WriteMatches(input, bodies, &section);
  section.html.Close();
  return section;
}

}  // namespace s2gs
