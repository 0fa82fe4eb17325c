#pragma once

#include <cstdint>
#include <filesystem>
#include <istream>
#include <ostream>

#include "s2gs/core/gaussians.h"

namespace s2gs {

enum class GaussianPlyLayout : uint8_t {
  k2dgs,  ///< two scales, as 2DGS writes and reads it.
  k3dgs,  ///< a third scale of almost nothing, for viewers that know 3D Gaussians only.
};

struct GaussianPlyOptions {
  GaussianPlyLayout layout = GaussianPlyLayout::k2dgs;
  bool foreground_only = false;  ///< only Gaussians with p >= tau.
};

/// Writes the PLY file of the 2DGS and 3DGS reference programs: x y z nx ny nz f_dc_* f_rest_* opacity
/// scale_* rot_*, all float and in the optimiser's parameters (opacity as logit, scales as logarithms, rot as
/// w x y z of unit length; f_rest channel by channel), and after them `foreground`, the probability p.
/// Normals are the splats'. The path form is atomic.
void WriteGaussianPly(const std::filesystem::path& path, const Gaussians& gaussians,
                      const GaussianPlyOptions& options = {});
void WriteGaussianPly(std::ostream& stream, const Gaussians& gaussians,
                      const GaussianPlyOptions& options = {});

/// Reads such a file, written by this program or another: f_rest of any degree up to 3, a third scale is
/// dropped, no `foreground` means p = 0. Throws UserError with the path for damaged files, missing columns
/// and values that are not finite. \param path  for the stream form: for messages only.
Gaussians ReadGaussianPly(const std::filesystem::path& path);
Gaussians ReadGaussianPly(std::istream& stream, const std::filesystem::path& path);

}  // namespace s2gs
