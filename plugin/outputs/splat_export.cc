#include "plugin/outputs/splat_export.h"

#include <Eigen/Geometry>
#include <cmath>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "mesh/io/glb_builder.h"
#include "plugin/outputs/export_place.h"
#include "s2gs/image/image_file.h"
#include "s2gs/kernel/foreground.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/image_name.h"
#include "sfm_split/scene/io/colmap_model.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr float kFlatScale = 1.125e-7F;  // exp(-16), as in PLY files of 3DGS
constexpr int kPoints = 0;               // glTF's mode

void WriteFloats(const std::vector<float>& values, std::ostream& stream) {
  stream.write(reinterpret_cast<const char*>(values.data()),
               static_cast<std::streamsize>(values.size() * sizeof(float)));
}

void Copy(const fs::path& from, const fs::path& to) {
  WriteUnlessOther(to, ReadWholeFile(from, kMaxImageBytes, "Run `s2gs gaussian_renderer` first"));
}

std::string WithPng(const std::string& name) {
  return fs::path(name).replace_extension(".png").generic_string();
}

// {"min": [x, y, z], "max": [x, y, z]} of the centres. \param object  one Gaussian at least.
json BoundsOf(const Gaussians& object) {
  json bounds;
  for (const bool is_max : {false, true}) {
    for (size_t c = 0; c < 3; ++c) {
      float bound = object.centre[c];
      for (size_t i = 0; i < object.size(); ++i) {
        bound =
            is_max ? std::max(bound, object.centre[3 * i + c]) : std::min(bound, object.centre[3 * i + c]);
      }
      bounds[is_max ? "max" : "min"].push_back(bound);
    }
  }
  return bounds;
}

// The k-th coefficient above degree 0 of all Gaussians, red, green and blue.
std::vector<float> ShBand(const Gaussians& object, size_t k) {
  std::vector<float> values;
  values.reserve(3 * object.size());
  for (size_t i = 0; i < object.size(); ++i) {
    const float* rest = object.sh_rest.data() + 3 * (kShRestPerChannel * i + k);
    values.insert(values.end(), rest, rest + 3);
  }
  return values;
}

}  // namespace

void WriteGaussianGlb(const Gaussians& gaussians, const fs::path& path, std::ostream& stream) {
  std::vector<uint32_t> chosen;
  for (size_t i = 0; i < gaussians.size(); ++i) {
    if (IsForeground(gaussians.foreground_logit[i])) chosen.push_back(static_cast<uint32_t>(i));
  }
  if (chosen.empty()) {
    throw UserError(path, "would have no splats: none belongs to the rotating part", "Train longer");
  }
  const Gaussians object = SelectGaussians(gaussians, chosen);
  const size_t count = object.size();
  GlbBuilder glb;
  json primitive = {{"mode", kPoints}, {"attributes", json::object()}};
  const auto add = [&](const std::string& name, const char* type, std::vector<float> values, json extra) {
    extra["componentType"] = kGlbFloat;
    extra["type"] = type;
    const uint64_t bytes = values.size() * sizeof(float);
    primitive["attributes"][name] =
        glb.AddAccessor(count, bytes, kGlbArrayBuffer, std::move(extra),
                        [values = std::move(values)](std::ostream& out) { WriteFloats(values, out); });
  };
  add("POSITION", "VEC3", object.centre, BoundsOf(object));
  std::vector<float> rotations;
  std::vector<float> scales;
  std::vector<float> opacities;
  for (size_t i = 0; i < count; ++i) {
    const float* r = object.rotation.data() + 4 * i;
    const Eigen::Quaternionf unit = Eigen::Quaternionf(r[0], r[1], r[2], r[3]).normalized();
    rotations.insert(rotations.end(), {unit.x(), unit.y(), unit.z(), unit.w()});
    scales.insert(scales.end(),
                  {std::exp(object.log_scale[2 * i]), std::exp(object.log_scale[2 * i + 1]), kFlatScale});
    opacities.push_back(Sigmoid(object.opacity_logit[i]));
  }
  const std::string prefix = "KHR_gaussian_splatting:";
  add(prefix + "ROTATION", "VEC4", std::move(rotations), json::object());
  add(prefix + "SCALE", "VEC3", std::move(scales), json::object());
  add(prefix + "OPACITY", "SCALAR", std::move(opacities), json::object());
  add(prefix + "SH_DEGREE_0_COEF_0", "VEC3", object.sh_dc, json::object());
  size_t k = 0;
  for (int degree = 1; degree <= object.sh_degree; ++degree) {
    for (int coefficient = 0; coefficient < 2 * degree + 1; ++coefficient, ++k) {
      add(prefix + "SH_DEGREE_" + std::to_string(degree) + "_COEF_" + std::to_string(coefficient), "VEC3",
          ShBand(object, k), json::object());
    }
  }
  primitive["extensions"]["KHR_gaussian_splatting"] = {{"kernel", "ellipse"},
                                                       {"colorSpace", "srgb_rec709_display"},
                                                       {"projection", "perspective"},
                                                       {"sortingMethod", "cameraDistance"}};
  glb.json()["extensionsUsed"] = {"KHR_gaussian_splatting"};
  glb.json()["meshes"][0]["primitives"][0] = std::move(primitive);
  glb.Write(stream, path);
}

void WriteSplatSet(const Workspace& workspace, const fs::path& image_path, const fs::path& folder,
                   Reporter& reporter) {
  for (const char* part : {"images", "masks", "sparse"})
    RequireFreePlace(workspace, image_path, folder / part);
  const ColmapModel model = ReadColmapModel(workspace.DenseModel());
  RequireNoOtherModel(folder / "sparse" / "0", model);
  std::vector<std::string> names;
  std::set<std::string> short_names;
  for (const auto& [id, image] : model.images) {
    names.push_back(image.name);
    short_names.insert(WithPng(image.name));
  }
  const bool has_short_names = short_names.size() == names.size();
  const ImageOutputs outputs(folder, image_path, names);
  int64_t done = 0;
  for (const std::string& name : names) {
    if (reporter.StopRequested()) throw Interrupted();
    reporter.Progress("write photos", done++, static_cast<int64_t>(names.size()));
    const ImageName checked(name, workspace.DenseModel());
    Copy(workspace.DenseImages() / name, outputs.Make(folder / "images", checked, ""));
    const ImageName mask(has_short_names ? WithPng(name) : name + ".png", workspace.DenseModel());
    Copy(workspace.DenseMasks() / (name + ".png"), outputs.Make(folder / "masks", mask, ""));
  }
  CreateFolder(folder / "sparse");
  WriteColmapModel(folder / "sparse" / "0", model, ColmapFormat::kBinary);
  reporter.Progress("write photos", done, done);
}

}  // namespace s2gs
