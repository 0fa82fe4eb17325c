#include "mesh/texture/texture_mesh.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <memory>
#include <optional>
#include <unordered_map>
#include <utility>
#include <vector>

#include "mesh/surface/vertex_normals.h"
#include "mesh/texture/blend_samples.h"
#include "mesh/texture/charts.h"
#include "mesh/texture/pack_rectangles.h"
#include "mesh/texture/page_fill.h"
#include "mesh/texture/photo_tones.h"
#include "mesh/texture/surface_places.h"
#include "mesh/texture/texel_raster.h"
#include "mesh/texture/texture_photo.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/base/stopwatch.h"

namespace s2gs {
namespace {

// Places at which photos are compared: their medians are good to some thousandths of a grey value's spread.
constexpr int kNumPlaces = 20'000;
// Photos that look at a place more steeply do not say how fine its texture is.
constexpr double kFacing = 0.7;
constexpr double kGiB = 1024.0 * 1024.0 * 1024.0;
// Of the memory: what candidates take, and photos; the rest is for pages.
constexpr double kCandidateShare = 0.4;
constexpr double kPhotoShare = 0.25;
// A page's picture, its states, and the picture's copy as it is filled.
constexpr double kPageBytesPerTexel = 7;
// Of the pages, before they are packed: what charts of a scanned mesh take of them at least.
constexpr double kLeastPageUse = 0.3;
constexpr int64_t kTexelsPerTurn = 4096;
constexpr int64_t kPlacesPerTurn = 256;
// Of light and exposures in turn.
constexpr int kLightRounds = 2;

// A texel of a chart and the place that it shows.
struct TexelPlace {
  uint32_t triangle = 0;
  uint16_t page = 0;
  uint16_t x = 0;
  uint16_t y = 0;
  uint8_t num_candidates = 0;
  float u = 0;  // barycentric, of the first and the second corner
  float v = 0;
};

class Texturer {
 public:
  Texturer(const TriangleMesh& mesh, const TexturePhotoSource& source, const TextureOptions& options,
           Reporter& reporter, TextureSummary* summary, TextureLight* light)
      : mesh_(mesh),
        source_(source),
        options_(options),
        num_threads_(NumThreadsOf(options.num_threads)),
        reporter_(reporter),
        summary_(*summary),
        light_(*light) {}

  TexturedMesh Run() {
    const std::vector<SurfacePlace> places = PlacesOnSurface(mesh_, kNumPlaces);
    if (places.empty()) throw UserError("the mesh has no triangles with area to give a texture to");
    ChooseTexelSize(places);
    ChartOptions chart_options{summary_.texel_size, options_.gutter, options_.max_page_size};
    charts_ = MakeCharts(mesh_, chart_options);
    Place();
    Compare(places);
    MakeAllTexels();
    FillUnseen();
    for (size_t page = 0; page < pages_.size(); ++page)
      FillGutters(options_.gutter, &states_[page], &pages_[page]);
    return Assemble();
  }

 private:
  void ChooseTexelSize(const std::vector<SurfacePlace>& places) {
    std::vector<double> pixels;
    pixels.reserve(places.size());
    double area = 0;
    for (const SurfacePlace& place : places) {
      double best = 0;  // pixels per unit of length
      area += place.area;
      for (int i = 0; i < source_.size(); ++i) {
        const ObjectView& view = source_.Camera(i);
        const Eigen::Vector3d to_camera = CameraCentre(view.cam_from_object) - place.x.cast<double>();
        if (place.normal.cast<double>().dot(to_camera) < kFacing * to_camera.norm()) continue;
        const Eigen::Vector3d x = view.cam_from_object * place.x.cast<double>();
        if (!(x.z() > 0)) continue;
        const double column = view.fx * x.x() / x.z() + view.cx;
        const double row = view.fy * x.y() / x.z() + view.cy;
        if (column < 0 || row < 0 || column > view.width || row > view.height) continue;
        best = std::max(best, std::sqrt(view.fx * view.fy) / x.z());
      }
      if (best > 0) pixels.push_back(1 / best);
    }
    if (pixels.empty()) throw UserError("no photo shows the mesh: does it belong to these poses?");
    const double pixel = UpperMedian(pixels);
    double texel = options_.texel_size > 0 ? options_.texel_size : options_.texel_size_pixels * pixel;
    const double most_texels = (1 - kCandidateShare - kPhotoShare) * options_.max_memory_gib * kGiB /
                               kPageBytesPerTexel * kLeastPageUse;
    if (area / (texel * texel) > most_texels) {
      const double larger = std::sqrt(area / most_texels);
      reporter_.Warn(fmt::format("texels of {:.4g} would need more than max_memory_gib = {}: they are {:.4g}",
                                 texel, options_.max_memory_gib, larger));
      texel = larger;
    }
    summary_.texel_size = texel;
    summary_.texel_pixels = texel / pixel;
  }

  // Gives charts their places on pages, which are blank.
  void Place() {
    std::vector<RectangleSize> sizes;
    sizes.reserve(charts_.size());
    for (const Chart& chart : charts_) sizes.push_back({chart.width, chart.height});
    packing_ = PackRectangles(sizes, options_.max_page_size);
    for (const RectangleSize& size : packing_.pages) {
      const size_t count = static_cast<size_t>(size.width) * size.height;
      pages_.push_back({size.width, size.height, 3, std::vector<uint8_t>(3 * count, 0)});
      states_.emplace_back(count, kBlankTexel);
    }
    // Charts in the order of their pages, and so the triangles.
    order_.resize(charts_.size());
    for (size_t i = 0; i < order_.size(); ++i) order_[i] = i;
    std::stable_sort(order_.begin(), order_.end(),
                     [&](size_t a, size_t b) { return packing_.places[a].page < packing_.places[b].page; });
    summary_.num_charts = static_cast<int64_t>(charts_.size());
  }

  // Prepares photos some at a time, as memory and threads allow, and calls `use(index, photo)` in their
  // order.
  void ForEachPhoto(const std::function<void(int, const TexturePhoto&)>& use) {
    double most_pixels = 1;
    for (int i = 0; i < source_.size(); ++i) {
      most_pixels =
          std::max(most_pixels, static_cast<double>(source_.Camera(i).width) * source_.Camera(i).height);
    }
    const double budget = kPhotoShare * options_.max_memory_gib * kGiB;
    // While it is prepared, the decoded photo and its mask stand beside it.
    const double bytes = most_pixels * (TexturePhoto::BytesPerPixel() + 4);
    const int at_once = std::clamp(static_cast<int>(budget / bytes), 1, num_threads_);
    for (int begin = 0; begin < source_.size(); begin += at_once) {
      if (reporter_.StopRequested()) throw Interrupted();
      const int count = std::min(at_once, source_.size() - begin);
      std::vector<std::unique_ptr<TexturePhoto>> photos(count);
      ParallelFor(count, num_threads_, [&](int64_t i) {
        const int index = begin + static_cast<int>(i);
        photos[i] = std::make_unique<TexturePhoto>(source_.Camera(index), source_.Load(index),
                                                   source_.LoadMask(index), mesh_);
      });
      for (int i = 0; i < count; ++i) use(begin + i, *photos[i]);
    }
  }

  // Photos with each other: their tones, and the light in them.
  void Compare(const std::vector<SurfacePlace>& places) {
    std::vector<ToneSample> samples;
    std::vector<std::optional<ToneSample>> of_place(places.size());
    ForEachPhoto([&](int index, const TexturePhoto& photo) {
      ParallelFor(static_cast<int64_t>(places.size()), num_threads_, kPlacesPerTurn, [&](int64_t i) {
        ToneSample sample{static_cast<uint32_t>(i), static_cast<uint16_t>(index), {}};
        const bool is_seen = photo.Sample(places[i].x, places[i].normal, &sample.sample);
        of_place[i] = is_seen ? std::optional(sample) : std::nullopt;
      });
      for (const std::optional<ToneSample>& sample : of_place) {
        if (sample) samples.push_back(*sample);
      }
    });
    if (samples.empty()) throw UserError("no photo shows the mesh: does it belong to these poses?");
    std::stable_sort(samples.begin(), samples.end(),
                     [](const ToneSample& a, const ToneSample& b) { return a.place < b.place; });
    EstimateAllTones(samples);
    if (options_.unshade) FindLight(places, &samples);
    double squares = 0;
    for (const PhotoTone& tone : tones_) squares += tone.gain.log().square().mean();
    summary_.gain_spread = std::sqrt(squares / static_cast<double>(tones_.size()));
    if (options_.equalise) return;
    for (PhotoTone& tone : tones_) tone.gain.setOnes();
  }

  void EstimateAllTones(const std::vector<ToneSample>& samples) {
    tones_ = EstimateTones(samples, source_.size(), num_threads_);
  }

  // Exposures look different under uneven light, and light by wrong exposures: in turn.
  void FindLight(const std::vector<SurfacePlace>& places, std::vector<ToneSample>* samples) {
    std::vector<Eigen::Matrix3d> turns;
    turns.reserve(source_.size());
    for (int i = 0; i < source_.size(); ++i) turns.push_back(source_.WorldFromObject(i));
    if (!Turns(turns)) return;
    light_.transfer = LightTransfer(mesh_, num_threads_);
    std::vector<LightTerms> transfers;
    transfers.reserve(places.size());
    for (const SurfacePlace& place : places)
      transfers.push_back(light_.transfer.At(place.triangle, place.u, place.v));
    for (int round = 0; round < kLightRounds; ++round) {
      if (reporter_.StopRequested()) throw Interrupted();
      std::vector<LitSample> lit;
      lit.reserve(samples->size());
      for (const ToneSample& s : *samples) {
        const Eigen::Array3f gain = options_.equalise ? tones_[s.photo].gain : Eigen::Array3f::Ones();
        lit.push_back({s.place, s.photo, gain * ColorOf(s.sample.smooth)});
      }
      const LightFinding found = FitTurnLight(lit, transfers, turns, num_threads_);
      light_.light = found.light;
      summary_.error_even = found.error_even;
      summary_.error_lit = found.error_lit;
      if (light_.light.is_even()) {
        if (round == 0) break;
        // What the round before found is not taken, and exposures by it are not.
        for (ToneSample& s : *samples) s.shade.setOnes();
        EstimateAllTones(*samples);
        break;
      }
      photo_lights_.clear();
      photo_lights_.reserve(turns.size());
      for (const Eigen::Matrix3d& turn : turns) photo_lights_.push_back(light_.light.Turned(turn));
      for (ToneSample& s : *samples) s.shade = light_.light.Shade(photo_lights_[s.photo], transfers[s.place]);
      EstimateAllTones(*samples);
    }
  }

  // The texels of a chart that no chart before has.
  void AddTexels(size_t chart_index, std::vector<TexelPlace>* texels) {
    const Chart& chart = charts_[chart_index];
    const PackedRectangle& place = packing_.places[chart_index];
    const int page_width = pages_[place.page].width;
    std::vector<uint8_t>& states = states_[place.page];
    for (const uint32_t t : chart.triangles) {
      TexelTriangle corners;
      for (int i = 0; i < 3; ++i) corners[i] = chart.Project(mesh_.vertices[mesh_.triangles[t][i]]);
      bool has_texel = false;
      const auto add = [&](const Texel& texel) {
        const int x = place.x + texel.x;
        const int y = place.y + texel.y;
        has_texel = true;
        uint8_t& state = states[static_cast<size_t>(y) * page_width + x];
        if (state != kBlankTexel) return;
        state = kUnseenTexel;
        texels->push_back({t, static_cast<uint16_t>(place.page), static_cast<uint16_t>(x),
                           static_cast<uint16_t>(y), 0, texel.weights[0], texel.weights[1]});
      };
      ForEachTexel(corners, chart.width, chart.height, add);
      if (has_texel) continue;
      // Too small to have a texel's centre in it: that of its middle, if nothing else has it.
      const Eigen::Vector2f middle = (corners[0] + corners[1] + corners[2]) / 3;
      constexpr float kThird = 1.0F / 3;
      add(Texel{static_cast<int>(middle.x()), static_cast<int>(middle.y()), {kThird, kThird, kThird}, false});
    }
  }

  void MakeAllTexels() {
    const double bytes = sizeof(TexelPlace) + kMaxCandidates * sizeof(TexelCandidate) + sizeof(SeenColor) +
                         sizeof(BlendedColor);
    const auto most =
        static_cast<size_t>(std::max(1.0, kCandidateShare * options_.max_memory_gib * kGiB / bytes));
    vertex_sums_.assign(mesh_.vertices.size(), Eigen::Array4f::Zero());
    corner_lights_.assign(3 * mesh_.triangles.size(), Eigen::Array4f::Zero());
    std::vector<TexelPlace> texels;
    for (size_t i = 0; i < order_.size(); ++i) {
      AddTexels(order_[i], &texels);
      // Of a chart that is larger than the memory is, a part at a time.
      while (texels.size() >= most) {
        const auto end = texels.begin() + static_cast<std::ptrdiff_t>(most);
        std::vector<TexelPlace> part(texels.begin(), end);
        texels.erase(texels.begin(), end);
        MakeTexels(&part);
      }
    }
    if (!texels.empty()) MakeTexels(&texels);
    double num_page_texels = 0;
    for (const Image8& page : pages_) num_page_texels += static_cast<double>(page.width) * page.height;
    summary_.page_use = static_cast<double>(summary_.num_texels) / num_page_texels;
    summary_.mean_photos /= static_cast<double>(std::max<int64_t>(1, summary_.num_seen));
  }

  void MakeTexels(std::vector<TexelPlace>* texels) {
    const auto count = static_cast<int64_t>(texels->size());
    // In parts that all threads make: on one, fresh pages took a fifth of the main thread (a cube of 35
    // photos). photo.
    std::vector<std::vector<TexelCandidate>> parts((count + kTexelsPerTurn - 1) / kTexelsPerTurn);
    ParallelFor(static_cast<int64_t>(parts.size()), num_threads_, [&](int64_t part) {
      const int64_t texels_of_part = std::min(kTexelsPerTurn, count - part * kTexelsPerTurn);
      parts[part].resize(static_cast<size_t>(texels_of_part) * kMaxCandidates);
    });
    const auto candidates_of = [&](int64_t i) {
      return parts[i / kTexelsPerTurn].data() + i % kTexelsPerTurn * kMaxCandidates;
    };
    std::vector<SeenColor> seen(texels->size());
    ForEachPhoto([&](int index, const TexturePhoto& photo) {
      ParallelFor(count, num_threads_, kTexelsPerTurn, [&](int64_t i) {
        TexelPlace& texel = (*texels)[i];
        const Triangle& corners = mesh_.triangles[texel.triangle];
        const auto mean = [&](const std::vector<Eigen::Vector3f>& values) -> Eigen::Vector3f {
          return texel.u * values[corners[0]] + texel.v * values[corners[1]] +
                 (1 - texel.u - texel.v) * values[corners[2]];
        };
        TexelCandidate candidate;
        candidate.photo = static_cast<uint16_t>(index);
        if (!photo.Sample(mean(mesh_.vertices), mean(mesh_.normals).normalized(), &candidate.sample)) return;
        AddCandidate(candidate, candidates_of(i), &texel.num_candidates);
        seen[i].Add(candidate.sample, tones_[index]);
      });
      reporter_.Progress("texture the mesh", index + 1, source_.size());
    });
    std::vector<BlendedColor> colors(texels->size());
    ParallelFor(count, num_threads_, kTexelsPerTurn, [&](int64_t i) {
      const TexelPlace& texel = (*texels)[i];
      if (texel.num_candidates > 0) colors[i] = Blend(texel, candidates_of(i), seen[i]);
    });
    for (int64_t i = 0; i < count; ++i) {
      const TexelPlace& texel = (*texels)[i];
      ++summary_.num_texels;
      if (texel.num_candidates == 0) {
        unseen_.push_back(texel);
        continue;
      }
      ++summary_.num_seen;
      summary_.mean_photos += texel.num_candidates;
      const auto& [color, light] = colors[i];
      SetTexel(texel, color, kSeenTexel);
      const Triangle& corners = mesh_.triangles[texel.triangle];
      const std::array<float, 3> weights = {texel.u, texel.v, 1 - texel.u - texel.v};
      for (int c = 0; c < 3; ++c) {
        if (!(weights[c] > 0)) continue;
        vertex_sums_[corners[c]] += weights[c] * Eigen::Array4f(color[0], color[1], color[2], 1);
        corner_lights_[3 * size_t{texel.triangle} + c] +=
            weights[c] * Eigen::Array4f(light[0], light[1], light[2], 1);
      }
    }
  }

  BlendedColor Blend(const TexelPlace& texel, const TexelCandidate* candidates, const SeenColor& seen) const {
    std::array<Eigen::Array3f, kMaxCandidates> shades;
    shades.fill(Eigen::Array3f::Ones());
    if (!light_.light.is_even()) {
      const LightTerms transfer = light_.transfer.At(texel.triangle, texel.u, texel.v);
      for (int k = 0; k < texel.num_candidates; ++k) {
        shades[k] = light_.light.Shade(photo_lights_[candidates[k].photo], transfer);
      }
    }
    return BlendSamples(candidates, shades.data(), texel.num_candidates, tones_, seen);
  }

  void SetTexel(const TexelPlace& texel, const Eigen::Array3f& color, uint8_t state) {
    uint8_t* pixel = pages_[texel.page].Pixel(texel.x, texel.y);
    for (int c = 0; c < 3; ++c)
      pixel[c] = static_cast<uint8_t>(std::lround(std::clamp(color[c], 0.0F, 255.0F)));
    states_[texel.page][static_cast<size_t>(texel.y) * pages_[texel.page].width + texel.x] = state;
  }

  // Texels that no photo sees get the colour that spreads over the mesh from those that are seen.
  void FillUnseen() {
    const std::vector<Eigen::Array3f> colors = SpreadVertexColors(mesh_, vertex_sums_);
    for (const TexelPlace& texel : unseen_) {
      const Triangle& corners = mesh_.triangles[texel.triangle];
      SetTexel(texel,
               texel.u * colors[corners[0]] + texel.v * colors[corners[1]] +
                   (1 - texel.u - texel.v) * colors[corners[2]],
               kSeenTexel);
    }
  }

  TexturedMesh Assemble() {
    TexturedMesh textured;
    int page = -1;
    const auto begin_page = [&] {
      ++page;
      textured.pages.push_back({std::move(pages_[page]), textured.triangles.size(), 0});
    };
    std::unordered_map<uint32_t, uint32_t> number_of;
    std::vector<Eigen::Array4f> lights;
    for (const size_t index : order_) {
      const Chart& chart = charts_[index];
      const PackedRectangle& place = packing_.places[index];
      while (page < place.page) begin_page();
      number_of.clear();
      for (const uint32_t t : chart.triangles) {
        Triangle triangle;
        for (int i = 0; i < 3; ++i) {
          const uint32_t v = mesh_.triangles[t][i];
          const auto [found, is_new] = number_of.emplace(v, static_cast<uint32_t>(textured.vertices.size()));
          triangle[i] = found->second;
          if (is_new) lights.push_back(Eigen::Array4f::Zero());
          lights[found->second] += corner_lights_[3 * size_t{t} + i];
          if (!is_new) continue;
          textured.vertices.push_back(mesh_.vertices[v]);
          textured.normals.push_back(mesh_.normals[v]);
          textured.texels.emplace_back(
              chart.Project(mesh_.vertices[v]) +
              Eigen::Vector2f(static_cast<float>(place.x), static_cast<float>(place.y)));
        }
        textured.triangles.push_back(triangle);
        light_.mesh_triangles.push_back(t);
        ++textured.pages.back().num_triangles;
      }
    }
    light_.page_lights.reserve(lights.size());
    for (const Eigen::Array4f& sum : lights) {
      light_.page_lights.emplace_back(sum[3] > 0 ? Eigen::Array3f(sum.head<3>() / sum[3])
                                                 : Eigen::Array3f::Ones());
    }
    return textured;
  }

  const TriangleMesh& mesh_;
  const TexturePhotoSource& source_;
  const TextureOptions& options_;
  const int num_threads_;
  Reporter& reporter_;
  TextureSummary& summary_;
  TextureLight& light_;
  std::vector<Chart> charts_;
  Packing packing_;
  std::vector<size_t> order_;  // of charts, by page
  std::vector<Image8> pages_;
  std::vector<std::vector<uint8_t>> states_;   // of the pages' texels
  std::vector<PhotoTone> tones_;               // of the photos
  std::vector<PhotoLight> photo_lights_;       // where the light is not even
  std::vector<Eigen::Array4f> vertex_sums_;    // colours of the texels around, and their weight
  std::vector<Eigen::Array4f> corner_lights_;  // of each triangle's corners: the light in the texels
  std::vector<TexelPlace> unseen_;
};

}  // namespace

Eigen::Array3f TextureLight::Shade(const PhotoLight& here, const TexturedMesh& mesh, uint32_t t, float u,
                                   float v) const {
  const Triangle& corners = mesh.triangles[t];
  const Eigen::Array3f in_page =
      u * page_lights[corners[0]] + v * page_lights[corners[1]] + (1 - u - v) * page_lights[corners[2]];
  return light.Shade(here, transfer.At(mesh_triangles[t], u, v)) / in_page;
}

OptionCheck TextureOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, fmt::format("{}", value), bound};
  };
  if (!(texel_size >= 0) || !(texel_size <= 1e30))
    return fault("texel_size", texel_size, "0 <= texel_size <= 1e30");
  if (!(texel_size_pixels >= 0.1) || !(texel_size_pixels <= 100)) {
    return fault("texel_size_pixels", texel_size_pixels, "0.1 <= texel_size_pixels <= 100");
  }
  if (max_page_size < 64 || max_page_size > 8192)
    return fault("max_page_size", max_page_size, "64 <= max_page_size <= 8192");
  if (gutter < 1 || gutter > 16) return fault("gutter", gutter, "1 <= gutter <= 16");
  if (!(max_memory_gib > 0) || !(max_memory_gib <= 1'048'576)) {
    return fault("max_memory_gib", max_memory_gib, "0 < max_memory_gib <= 1048576");
  }
  if (num_threads < 0 || num_threads > 4096)
    return fault("num_threads", num_threads, "0 <= num_threads <= 4096");
  return std::nullopt;
}

TexturedMesh TextureMesh(const TriangleMesh& mesh, const TexturePhotoSource& photos,
                         const TextureOptions& options, Reporter& reporter, TextureSummary* summary,
                         TextureLight* light) {
  const double start = SteadySeconds();
  *summary = {};
  if (photos.size() > 65535) throw UserError("texture is taken from 65535 photos at most");
  TriangleMesh with_normals;
  with_normals.vertices = mesh.vertices;
  with_normals.triangles = mesh.triangles;
  ComputeNormals(&with_normals);
  TextureLight own;
  TextureLight& found = light != nullptr ? *light : own;
  found = {};
  TexturedMesh textured = Texturer(with_normals, photos, options, reporter, summary, &found).Run();
  summary->seconds = SteadySeconds() - start;
  return textured;
}

}  // namespace s2gs
