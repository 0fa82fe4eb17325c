#pragma once

#include <filesystem>
#include <ostream>

#include "plugin/stage/workspace.h"
#include "s2gs/core/gaussians.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// The rotating part's splats (p >= tau) as glTF 2.0 in one binary file, with the ratified extension
/// KHR_gaussian_splatting: scales as lengths, opacities from 0 to 1, quaternions x y z w, spherical harmonics
/// as 3DGS has them; the third scale is almost nothing. A node turns z up into the format's y up. Throws
/// UserError when no splat belongs to the rotating part. \param path  for messages.
void WriteGaussianGlb(const Gaussians& gaussians, const std::filesystem::path& path, std::ostream& stream);

/// A folder as trainers of splats read it (gsplat, LichtFeld, Brush, COLMAP's own layout): images without
/// distortion, sparse/0 with their PINHOLE cameras, and masks/ of the object, named as the photos but with
/// .png (NAME.EXT.png where two would be equal). All from dense/0. Throws UserError when that is missing, for
/// names that lead out, and rather than write over anything: photos, the workspace's own files, other
/// pictures and models. \param image_path  the photos.
void WriteSplatSet(const Workspace& workspace, const std::filesystem::path& image_path,
                   const std::filesystem::path& folder, Reporter& reporter);

}  // namespace s2gs
