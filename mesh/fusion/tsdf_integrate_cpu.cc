#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "mesh/fusion/tsdf_cull.h"
#include "mesh/fusion/tsdf_integrate.h"
#include "mesh/fusion/tsdf_kernel_cpu.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

class CpuIntegrator : public TsdfIntegrator {
 public:
  CpuIntegrator(int num_threads, TsdfVolume* volume) : num_threads_(num_threads), volume_(*volume) {}

  TsdfBackend backend() const override { return TsdfBackend::kCpu; }
  std::string device() const override {
    return std::to_string(num_threads_) + (num_threads_ == 1 ? " thread" : " threads");
  }

  // Each voxel meets the views in their order, whichever thread works on it.
  void Add(const std::vector<const TsdfView*>& views, const TsdfVoxelParams& voxel) override {
    const auto num_views = static_cast<int>(views.size());
    std::vector<TsdfViewParams> params(views.size());
    std::vector<TsdfDepthTiles> tiles(views.size());
    ParallelFor(num_views, num_threads_, [&](int64_t i) {
      params[i] = ViewParams(*views[i], volume_.origin, volume_.voxel_size);
      tiles[i] = MakeTsdfDepthTiles(*views[i], volume_.truncation, volume_.voxel_size);
    });
    // A little more than the half diagonal between a block's outermost voxels.
    const auto radius = static_cast<float>((kBlockSide - 1) * 0.5 * 1.7330 * volume_.voxel_size);
    const TsdfCpuKernel& kernel = BestTsdfCpuKernel();
    const int num_blocks = volume_.blocks.size();
    ParallelFor(num_blocks, num_threads_, 16, [&](int64_t b) {
      const Eigen::Vector3i block = volume_.blocks.Block(static_cast<int>(b));
      float* sums = &volume_.distances[static_cast<size_t>(b) * kBlockVoxels];
      float* weights = &volume_.weights[static_cast<size_t>(b) * kBlockVoxels];
      for (int i = 0; i < num_views; ++i) {
        float first_voxel[3];
        BlockInCamera(params[i], block.x(), block.y(), block.z(), first_voxel);
        float middle[3];
        for (int axis = 0; axis < 3; ++axis) {
          const double* row = params[i].rotation + 3 * axis;
          middle[axis] =
              first_voxel[axis] + static_cast<float>((kBlockSide - 1) * 0.5 * (row[0] + row[1] + row[2]));
        }
        if (MayMatter(params[i], tiles[i], middle, radius)) {
          kernel.add_to_block(params[i], voxel, first_voxel, sums, weights);
        }
      }
    });
  }

  void Finish() override {
    const auto num_voxels = static_cast<int64_t>(volume_.distances.size());
    ParallelFor(num_voxels, num_threads_, int64_t{kBlockVoxels} * 16, [&](int64_t i) {
      if (volume_.weights[i] > 0) volume_.distances[i] /= volume_.weights[i];
    });
  }

 private:
  int num_threads_;
  TsdfVolume& volume_;
};

}  // namespace

std::unique_ptr<TsdfIntegrator> MakeCpuIntegrator(int num_threads, TsdfVolume* volume) {
  return std::make_unique<CpuIntegrator>(num_threads, volume);
}

}  // namespace s2gs
