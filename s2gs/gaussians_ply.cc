#include "s2gs/gaussians_ply.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "s2gs/kernel/foreground.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/scene/io/ply_file.h"

namespace s2gs {
namespace {

constexpr float kFlatLogScale = -16;      // exp(-16): no thickness beside any splat that is seen.
constexpr float kMinProbability = 1e-6F;  // keeps the logit of a stored 0 or 1 finite.
constexpr std::array<int, kMaxShDegree + 1> kRestOfDegree = {0, 3, 8, 15};

float Logit(float p) {
  const float inside = std::clamp(p, kMinProbability, 1 - kMinProbability);
  return std::log(inside / (1 - inside));
}

// Column `part` of rows of `width` floats.
std::vector<float> Column(const std::vector<float>& rows, size_t width, size_t part,
                          const std::vector<uint32_t>& indices) {
  std::vector<float> column;
  column.reserve(indices.size());
  for (const uint32_t index : indices) column.push_back(rows[width * index + part]);
  return column;
}

std::vector<uint32_t> Chosen(const Gaussians& gaussians, const GaussianPlyOptions& options) {
  std::vector<uint32_t> chosen;
  chosen.reserve(gaussians.size());
  for (size_t i = 0; i < gaussians.size(); ++i) {
    if (options.foreground_only && !IsForeground(gaussians.foreground_logit[i])) continue;
    chosen.push_back(static_cast<uint32_t>(i));
  }
  return chosen;
}

PlyFile ToPly(const Gaussians& gaussians, const GaussianPlyOptions& options) {
  const std::vector<uint32_t> chosen = Chosen(gaussians, options);
  PlyElement vertex;
  vertex.name = "vertex";
  vertex.num_rows = chosen.size();
  const auto add = [&](const std::string& name, const std::vector<float>& rows, size_t width, size_t part) {
    vertex.AddColumn(name, Column(rows, width, part, chosen));
  };
  for (size_t i = 0; i < 3; ++i) add({"xyz"[i]}, gaussians.centre, 3, i);

  std::array<std::vector<float>, 3> normals;
  std::array<std::vector<float>, 4> rotations;
  for (auto& column : normals) column.reserve(chosen.size());
  for (auto& column : rotations) column.reserve(chosen.size());
  for (const uint32_t index : chosen) {
    const float* r = gaussians.rotation.data() + 4 * static_cast<size_t>(index);
    const Eigen::Quaternionf unit = Eigen::Quaternionf(r[0], r[1], r[2], r[3]).normalized();
    const Eigen::Vector3f normal = unit * Eigen::Vector3f::UnitZ();
    for (int i = 0; i < 3; ++i) normals[i].push_back(normal[i]);
    rotations[0].push_back(unit.w());
    rotations[1].push_back(unit.x());
    rotations[2].push_back(unit.y());
    rotations[3].push_back(unit.z());
  }
  for (size_t i = 0; i < 3; ++i) vertex.AddColumn(std::string("n") + "xyz"[i], std::move(normals[i]));

  for (size_t i = 0; i < 3; ++i) add("f_dc_" + std::to_string(i), gaussians.sh_dc, 3, i);
  for (size_t channel = 0; channel < 3; ++channel) {
    for (size_t k = 0; k < kShRestPerChannel; ++k) {
      add("f_rest_" + std::to_string(channel * kShRestPerChannel + k), gaussians.sh_rest,
          3 * kShRestPerChannel, 3 * k + channel);
    }
  }
  add("opacity", gaussians.opacity_logit, 1, 0);
  for (size_t i = 0; i < 2; ++i) add("scale_" + std::to_string(i), gaussians.log_scale, 2, i);
  if (options.layout == GaussianPlyLayout::k3dgs) {
    vertex.AddColumn("scale_2", std::vector<float>(chosen.size(), kFlatLogScale));
  }
  for (size_t i = 0; i < 4; ++i) vertex.AddColumn("rot_" + std::to_string(i), std::move(rotations[i]));
  std::vector<float> foreground = Column(gaussians.foreground_logit, 1, 0, chosen);
  for (float& value : foreground) value = Sigmoid(value);
  vertex.AddColumn("foreground", std::move(foreground));

  PlyFile file;
  file.elements.push_back(std::move(vertex));
  return file;
}

// The columns of one element, as floats that are known to be finite.
class Columns {
 public:
  Columns(const PlyElement& element, const std::filesystem::path& path) : element_(element), path_(path) {}

  bool Has(const std::string& name) const { return element_.Find(name) != nullptr; }

  std::vector<float> Get(const std::string& name) const {
    std::vector<float> values = PlyFloats(RequirePlyScalar(element_, name, path_).values);
    for (size_t row = 0; row < values.size(); ++row) {
      if (std::isfinite(values[row])) continue;
      throw UserError(path_, "vertex " + std::to_string(row) + ": " + name + " is not a finite number",
                      "Write the file again");
    }
    return values;
  }

  void Scatter(const std::string& name, std::vector<float>* rows, size_t width, size_t part) const {
    const std::vector<float> values = Get(name);
    for (size_t row = 0; row < values.size(); ++row) (*rows)[width * row + part] = values[row];
  }

 private:
  const PlyElement& element_;
  const std::filesystem::path& path_;
};

int RestPerChannel(const Columns& columns, const std::filesystem::path& path) {
  int count = 0;
  while (count < 3 * kShRestPerChannel && columns.Has("f_rest_" + std::to_string(count))) ++count;
  if (std::find(kRestOfDegree.begin(), kRestOfDegree.end(), count / 3) == kRestOfDegree.end() ||
      count % 3 != 0) {
    throw UserError(path, "has " + std::to_string(count) + " columns f_rest_*, not 0, 9, 24 or 45",
                    "Write it again with whole bands of spherical harmonics");
  }
  return count / 3;
}

}  // namespace

void WriteGaussianPly(std::ostream& stream, const Gaussians& gaussians, const GaussianPlyOptions& options) {
  WritePly(stream, ToPly(gaussians, options));
}

void WriteGaussianPly(const std::filesystem::path& path, const Gaussians& gaussians,
                      const GaussianPlyOptions& options) {
  WriteFileAtomically(path, [&](std::ostream& stream) { WriteGaussianPly(stream, gaussians, options); });
}

Gaussians ReadGaussianPly(std::istream& stream, const std::filesystem::path& path) {
  const PlyFile file = ReadPly(stream, path);
  const PlyElement* vertex = file.Find("vertex");
  if (vertex == nullptr) {
    throw UserError(path, "has no element \"vertex\"", "Give a point_cloud.ply of 2DGS, 3DGS or s2gs");
  }
  const Columns columns(*vertex, path);
  columns.Get("x");  // also the proof that rows exist before anything of their count is allocated.
  const int rest = RestPerChannel(columns, path);

  Gaussians gaussians;
  gaussians.Resize(vertex->num_rows);
  for (size_t i = 0; i < 3; ++i) columns.Scatter({"xyz"[i]}, &gaussians.centre, 3, i);
  for (size_t i = 0; i < 2; ++i) columns.Scatter("scale_" + std::to_string(i), &gaussians.log_scale, 2, i);
  for (size_t i = 0; i < 4; ++i) columns.Scatter("rot_" + std::to_string(i), &gaussians.rotation, 4, i);
  columns.Scatter("opacity", &gaussians.opacity_logit, 1, 0);
  for (size_t i = 0; i < 3; ++i) columns.Scatter("f_dc_" + std::to_string(i), &gaussians.sh_dc, 3, i);
  for (int channel = 0; channel < 3; ++channel) {
    for (int k = 0; k < rest; ++k) {
      columns.Scatter("f_rest_" + std::to_string(channel * rest + k), &gaussians.sh_rest,
                      3 * kShRestPerChannel, static_cast<size_t>(3) * k + channel);
    }
  }
  if (columns.Has("foreground")) columns.Scatter("foreground", &gaussians.foreground_logit, 1, 0);
  for (float& value : gaussians.foreground_logit) value = Logit(value);
  for (size_t row = 0; row < gaussians.size(); ++row) {
    const float* r = gaussians.rotation.data() + 4 * row;
    if (r[0] != 0 || r[1] != 0 || r[2] != 0 || r[3] != 0) continue;
    throw UserError(path, "vertex " + std::to_string(row) + ": the rotation is zero", "Write the file again");
  }
  gaussians.sh_degree = 0;
  while (kRestOfDegree[gaussians.sh_degree] < rest) ++gaussians.sh_degree;
  return gaussians;
}

Gaussians ReadGaussianPly(const std::filesystem::path& path) {
  std::ifstream stream = OpenForReading(path, "Run `s2gs gaussian_trainer` first");
  return ReadGaussianPly(stream, path);
}

}  // namespace s2gs
