#include "plugin/outputs/texture_workspace.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <system_error>
#include <utility>

#include "mesh/io/textured_mesh_files.h"
#include "mesh/texture/render_textured.h"
#include "plugin/outputs/dense_views.h"
#include "plugin/outputs/photo_turns.h"
#include "s2gs/image/image_error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/image_name.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/scene/io/turntable_file.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

class WorkspaceTexturePhotos : public TexturePhotoSource {
 public:
  WorkspaceTexturePhotos(const std::vector<DenseViewFiles>& files, const PhotoTurns& turns) : photos_(files) {
    turns_.reserve(files.size());
    for (const DenseViewFiles& view : files) turns_.push_back(turns.Of(view.name));
  }
  int size() const override { return photos_.size(); }
  const ObjectView& Camera(int index) const override { return photos_.Camera(index); }
  Image8 Load(int index) const override { return photos_.Load(index, 3); }
  Eigen::Matrix3d WorldFromObject(int index) const override { return turns_[index]; }
  Image8 LoadMask(int index) const override { return photos_.LoadMask(index); }

 private:
  DensePhotos photos_;
  std::vector<Eigen::Matrix3d> turns_;
};

// The mask's pixels that have all eight neighbours in it.
PixelMask Eroded(const PixelMask& mask) {
  PixelMask eroded{mask.width, mask.height, std::vector<uint8_t>(mask.inside.size(), 0)};
  for (int y = 1; y + 1 < mask.height; ++y) {
    for (int x = 1; x + 1 < mask.width; ++x) {
      bool is_inside = true;
      for (int dy = -1; dy <= 1; ++dy) {
        for (int dx = -1; dx <= 1; ++dx) {
          is_inside = is_inside && mask.inside[static_cast<size_t>(y + dy) * mask.width + x + dx] != 0;
        }
      }
      eroded.inside[static_cast<size_t>(y) * mask.width + x] = is_inside ? 1 : 0;
    }
  }
  return eroded;
}

HeldOutTexture Measure(const TexturedMesh& mesh, const TextureLight& light,
                       const std::vector<DenseViewFiles>& files, const PhotoTurns& turns,
                       const fs::path& render_path, Reporter& reporter) {
  HeldOutTexture result;
  const DensePhotos photos(files);
  std::vector<double> psnrs;
  std::vector<double> psnrs_lit;
  int64_t num_pixels = 0;
  int64_t num_covered = 0;
  for (int i = 0; i < photos.size(); ++i) {
    if (reporter.StopRequested()) throw Interrupted();
    const Image8 photo = photos.Load(i, 3);
    const Image8 mask_image = photos.LoadMask(i);
    const TexturedRendering rendering = RenderTexturedMesh(mesh, photos.Camera(i));
    TexturedRendering lit = rendering;
    if (!light.light.is_even()) {
      const PhotoLight here = light.light.Turned(turns.Of(files[i].name));
      lit = RenderTexturedMesh(mesh, photos.Camera(i), 2, [&](uint32_t t, float u, float v) {
        return light.Shade(here, mesh, t, u, v);
      });
    }
    if (!render_path.empty()) {
      WriteImage(
          ImageOutputs(render_path, {}, {}).Make(render_path, ImageName(files[i].name, render_path), ".png"),
          lit.image);
    }
    PixelMask mask = rendering.covered;
    if (!mask_image.pixels.empty()) {
      mask = ResizeNearest(MaskFromImage(mask_image), photo.width, photo.height);
    }
    mask = Eroded(mask);
    if (mask.Count() == 0) continue;
    psnrs.push_back(Psnr(rendering.image, photo, &mask));
    psnrs_lit.push_back(Psnr(lit.image, photo, &mask));
    num_pixels += mask.Count();
    for (size_t p = 0; p < mask.inside.size(); ++p) {
      num_covered += mask.inside[p] != 0 && rendering.covered.inside[p] != 0 ? 1 : 0;
    }
  }
  result.num_photos = static_cast<int>(psnrs.size());
  result.psnr = Summarize(psnrs).mean;
  result.psnr_lit = Summarize(psnrs_lit).mean;
  if (num_pixels > 0)
    result.covered_share = static_cast<double>(num_covered) / static_cast<double>(num_pixels);
  return result;
}

}  // namespace

OptionCheck TextureWorkspaceOptions::Check() const {
  if (test_every < 0 || test_every == 1) {
    return OptionFault{"test_every", std::to_string(test_every), "test_every = 0 or test_every >= 2"};
  }
  return std::nullopt;
}

TextureWorkspaceSummary TextureWorkspace(const Workspace& workspace, const TextureWorkspaceOptions& options,
                                         Reporter& reporter) {
  const fs::path mesh_path = options.mesh_path.empty() ? workspace.TsdfMesh() : options.mesh_path;
  const fs::path base = options.output_path.empty() ? workspace.TexturedMesh() : options.output_path;
  std::error_code ec;
  if (!fs::exists(mesh_path, ec)) {
    throw UserError(mesh_path, "there is no mesh to texture", "Run `s2gs tsdf_mesher` first");
  }
  const TriangleMesh mesh = ReadPlyMesh(mesh_path);
  if (mesh.triangles.empty()) {
    throw UserError(mesh_path, "has no triangles to give a texture to", "Run `s2gs tsdf_mesher` again");
  }
  if (!options.render_path.empty()) CreateFolder(options.render_path);
  std::vector<DenseViewFiles> train;
  std::vector<DenseViewFiles> held_out;
  const std::vector<DenseViewFiles> views =
      FindDenseViews(workspace, {options.mask_path, "geometric", false}, reporter);
  for (size_t i = 0; i < views.size(); ++i) {
    if (views[i].image.empty()) continue;
    const bool is_held_out = options.test_every > 0 && i % static_cast<size_t>(options.test_every) == 0;
    (is_held_out ? held_out : train).push_back(views[i]);
  }
  if (train.empty()) {
    throw UserError(workspace.DenseImages(), "holds no photo of an image of dense/0/sparse",
                    "Run `s2gs gaussian_renderer` or `colmap image_undistorter` first");
  }
  TextureWorkspaceSummary summary;
  summary.num_photos = static_cast<int>(train.size());
  for (const DenseViewFiles& view : train) summary.num_masks += view.mask.empty() ? 0 : 1;
  const PhotoTurns turns(workspace, views);
  const WorkspaceTexturePhotos photos(train, turns);
  TextureLight light;
  const TexturedMesh textured =
      TextureMesh(mesh, photos, options.texture, reporter, &summary.texture, &light);
  for (const TexturePage& page : textured.pages)
    summary.pages.push_back({page.image.width, page.image.height});
  summary.held_out = Measure(textured, light, held_out, turns, options.render_path, reporter);
  summary.written = WriteTexturedMesh(base, textured);
  return summary;
}

}  // namespace s2gs
