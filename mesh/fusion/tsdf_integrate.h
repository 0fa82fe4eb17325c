#pragma once

#include <memory>
#include <string>
#include <vector>

#include "mesh/fusion/tsdf.h"
#include "mesh/fusion/tsdf_view.h"
#include "mesh/fusion/tsdf_voxel.h"

namespace s2gs {

/// Adds views to a volume: the only part of the fusion that a backend owns. `distances` hold weighted sums
/// until Finish divides them by the weights.
class TsdfIntegrator {
 public:
  TsdfIntegrator() = default;
  TsdfIntegrator(const TsdfIntegrator&) = delete;
  TsdfIntegrator& operator=(const TsdfIntegrator&) = delete;
  virtual ~TsdfIntegrator() = default;

  virtual TsdfBackend backend() const = 0;
  virtual std::string device() const = 0;
  /// Views of several calls are added in their order.
  virtual void Add(const std::vector<const TsdfView*>& views, const TsdfVoxelParams& params) = 0;
  virtual void Finish() = 0;
};

/// \param volume  with its grid and blocks, and distances and weights of 0; must outlive the integrator.
std::unique_ptr<TsdfIntegrator> MakeCpuIntegrator(int num_threads, TsdfVolume* volume);

/// Null when this build has no CUDA backend or no GPU can be used. Throws UserError when the GPU's memory
/// does not suffice.
std::unique_ptr<TsdfIntegrator> MakeCudaIntegrator(TsdfVolume* volume);

}  // namespace s2gs
