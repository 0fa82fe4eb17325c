#pragma once

#include <filesystem>
#include <vector>

#include "mesh/texture/texture_mesh.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

struct TextureWorkspaceOptions {
  std::filesystem::path mesh_path;    ///< .ply; empty: dense/0/meshed-tsdf.ply.
  std::filesystem::path output_path;  ///< without an extension; empty: dense/0/textured-tsdf.
  std::filesystem::path mask_path;    ///< empty: dense/0/masks or, for photos without distortion, masks.
  std::filesystem::path
      render_path;  ///< of pictures NAME.png of the result in the held-out views, lit as there; empty: none.
  int test_every = 0;  ///< every n-th photo by name gives no texture, and the result is compared with it.
  TextureOptions texture;

  OptionCheck Check() const;
};

/// The textured mesh beside photos that it was not made from, over the pixels of the object's mask whose
/// eight neighbours are in it, too: outlines mix in the background, which the mesh does not have.
struct HeldOutTexture {
  int num_photos = 0;
  double psnr = 0;      ///< mean over the photos [dB]; pixels without mesh are black. NaN without photos.
  double psnr_lit = 0;  ///< the same of the mesh in the light that falls on it in each photo.
  double covered_share = 0;  ///< of these pixels, with mesh.
};

struct TextureWorkspaceSummary {
  TextureSummary texture;
  HeldOutTexture held_out;
  int num_photos = 0;
  int num_masks = 0;
  std::vector<ImageSize> pages;
  std::vector<std::filesystem::path> written;
};

/// Gives the workspace's mesh the colours of the photos of dense/0 and writes it (WriteTexturedMesh). Throws
/// UserError when there is no mesh or no photo.
TextureWorkspaceSummary TextureWorkspace(const Workspace& workspace, const TextureWorkspaceOptions& options,
                                         Reporter& reporter);

}  // namespace s2gs
