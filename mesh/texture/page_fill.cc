#include "mesh/texture/page_fill.h"

#include <cmath>
#include <cstddef>
#include <utility>

namespace s2gs {

namespace {

// What no photo and no gutter coloured takes the mean of what has a colour.
void FillTheRest(const std::vector<uint8_t>& states, Image8* page) {
  double sums[3] = {0, 0, 0};
  int64_t count = 0;
  for (size_t i = 0; i < states.size(); ++i) {
    if (states[i] != kSeenTexel) continue;
    for (int c = 0; c < 3; ++c) sums[c] += page->pixels[3 * i + c];
    ++count;
  }
  for (size_t i = 0; i < states.size() && count > 0; ++i) {
    if (states[i] == kSeenTexel) continue;
    for (int c = 0; c < 3; ++c) {
      page->pixels[3 * i + c] = static_cast<uint8_t>(std::lround(sums[c] / static_cast<double>(count)));
    }
  }
}

}  // namespace

void FillGutters(int gutter, std::vector<uint8_t>* states, Image8* page) {
  const int width = page->width;
  const int height = page->height;
  const auto at = [&](int x, int y) { return static_cast<size_t>(y) * width + x; };
  std::vector<std::pair<int, int>> edge;  // blank texels beside coloured ones
  const auto look_around = [&](int x, int y, const auto& use) {
    for (int dy = -1; dy <= 1; ++dy) {
      for (int dx = -1; dx <= 1; ++dx) {
        const int nx = x + dx;
        const int ny = y + dy;
        if (nx >= 0 && ny >= 0 && nx < width && ny < height) use(nx, ny);
      }
    }
  };
  const auto has_color = [&](int x, int y) {
    bool found = false;
    look_around(x, y, [&](int nx, int ny) { found = found || (*states)[at(nx, ny)] == kSeenTexel; });
    return found;
  };
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      if ((*states)[at(x, y)] == kBlankTexel && has_color(x, y)) edge.emplace_back(x, y);
    }
  }
  constexpr uint8_t kQueued = 3;
  for (int round = 0; round < gutter; ++round) {
    for (const auto& [x, y] : edge) {
      int sum[3] = {0, 0, 0};
      int count = 0;
      look_around(x, y, [&](int nx, int ny) {
        if ((*states)[at(nx, ny)] != kSeenTexel) return;
        const uint8_t* pixel = page->Pixel(nx, ny);
        for (int c = 0; c < 3; ++c) sum[c] += pixel[c];
        ++count;
      });
      for (int c = 0; c < 3; ++c) page->Pixel(x, y)[c] = static_cast<uint8_t>((sum[c] + count / 2) / count);
    }
    for (const auto& [x, y] : edge) (*states)[at(x, y)] = kSeenTexel;
    std::vector<std::pair<int, int>> next;
    for (const auto& [x, y] : edge) {
      look_around(x, y, [&](int nx, int ny) {
        uint8_t& state = (*states)[at(nx, ny)];
        if (state != kBlankTexel) return;
        state = kQueued;
        next.emplace_back(nx, ny);
      });
    }
    edge = std::move(next);
  }
  FillTheRest(*states, page);
}

std::vector<Eigen::Array3f> SpreadVertexColors(const TriangleMesh& mesh,
                                               const std::vector<Eigen::Array4f>& sums) {
  std::vector<Eigen::Array3f> colors(sums.size(), Eigen::Array3f::Zero());
  std::vector<uint8_t> is_known(sums.size(), 0);
  Eigen::Array4d all = Eigen::Array4d::Zero();
  for (size_t i = 0; i < sums.size(); ++i) {
    if (!(sums[i][3] > 0)) continue;
    colors[i] = sums[i].head<3>() / sums[i][3];
    is_known[i] = 1;
    all += sums[i].cast<double>();
  }
  // Ring by ring around what is known. Triangles whose corners are all known are done with.
  std::vector<uint32_t> open;
  open.reserve(mesh.triangles.size());
  for (size_t t = 0; t < mesh.triangles.size(); ++t) open.push_back(static_cast<uint32_t>(t));
  std::vector<Eigen::Array4f> ring(sums.size(), Eigen::Array4f::Zero());
  for (bool has_grown = true; has_grown;) {
    has_grown = false;
    std::vector<uint32_t> rest;
    std::vector<uint32_t> reached;
    for (const uint32_t t : open) {
      const Triangle& corners = mesh.triangles[t];
      bool is_done = true;
      for (int i = 0; i < 3; ++i) {
        if (is_known[corners[i]] != 0) continue;
        is_done = false;
        for (int j = 0; j < 3; ++j) {
          if (is_known[corners[j]] == 0) continue;
          const Eigen::Array3f& color = colors[corners[j]];
          ring[corners[i]] += Eigen::Array4f(color[0], color[1], color[2], 1);
          reached.push_back(corners[i]);
        }
      }
      if (!is_done) rest.push_back(t);
    }
    for (const uint32_t v : reached) {
      if (is_known[v] != 0) continue;
      is_known[v] = 1;
      colors[v] = ring[v].head<3>() / ring[v][3];
      has_grown = true;
    }
    open = std::move(rest);
  }
  Eigen::Array3f mean = Eigen::Array3f::Constant(128);
  if (all[3] > 0) mean = (all.head<3>() / all[3]).cast<float>();
  for (size_t i = 0; i < colors.size(); ++i) {
    if (is_known[i] == 0) colors[i] = mean;
  }
  return colors;
}

}  // namespace s2gs
