#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "mesh/fusion/depth_view.h"
#include "mesh/fusion/tsdf_voxel.h"
#include "mesh/surface/triangle_mesh.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// Truncated signed distance field of a surface that depth maps show (Curless and Levoy, "A volumetric method
/// for building complex models from range images", SIGGRAPH 1996), in sparse blocks of voxels.

enum class TsdfBackend { kAuto, kCpu, kCuda };

struct TsdfOptions {
  double voxel_size = 0;  ///< edge of a voxel, in the poses' unit; 0: from the depth maps.
  /// Chosen edge, in pixels at the surface's median depth. Depth maps of a trained model are noisier than a
  /// pixel: one and a half averages more of them (falcon_desk: 0.364 % of its size off,
  /// 0.396 at 1 pixel and 0.369 at 2).
  double voxel_size_pixels = 1.5;
  int max_resolution = 1024;       ///< voxels along the object's longest side, when the edge is chosen.
  double truncation_voxels = 4;    ///< distances are known this far from the surface.
  double max_view_angle_deg = 80;  ///< between a surface's normal and the ray; steeper pixels do not count.
  double mask_threshold = 0.5;     ///< of the mask's 0 to 1: from here on a pixel shows the object.
  bool carve = true;               ///< space in front of pixels outside the mask is empty.
  double max_memory_gib = 8;       ///< a fusion that would need more is refused before it is allocated.
  int num_threads = 0;             ///< 0: one for each core.
  TsdfBackend backend = TsdfBackend::kAuto;  ///< kAuto: CUDA where a GPU can be used, else the CPU.

  OptionCheck Check() const;
};

/// Where the blocks of a volume are, by their coordinates in blocks.
class TsdfBlockIndex {
 public:
  static constexpr int kNone = -1;
  static constexpr int kMaxCoordinate = (1 << 20) - 1;  ///< of a block, either way from 0.

  TsdfBlockIndex() = default;
  /// \param keys  of BlockKey, sorted, distinct.
  explicit TsdfBlockIndex(std::vector<uint64_t> keys);

  int size() const { return static_cast<int>(keys_.size()); }
  Eigen::Vector3i Block(int index) const;
  /// kNone where there is no block.
  int Find(const Eigen::Vector3i& block) const;

  /// Neighbours in space get neighbouring keys (Morton order).
  static uint64_t BlockKey(const Eigen::Vector3i& block);
  static Eigen::Vector3i BlockOfKey(uint64_t key);

 private:
  std::vector<uint64_t> keys_;
  std::vector<int32_t> table_;  // open addressing, a power of two
};

/// Voxel (x, y, z) of block b lies at origin + voxel_size * (8 * b + (x, y, z)); its values have the index
/// 512 * b + 64 * z + 8 * y + x.
struct TsdfVolume {
  double voxel_size = 0;
  double truncation = 0;                             ///< in the poses' unit.
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  ///< in the object's frame.
  TsdfBlockIndex blocks;
  std::vector<float> distances;  ///< signed, positive outside [voxels].
  std::vector<float> weights;    ///< 0: not seen; the distance means nothing.
};

/// How a fusion went.
struct TsdfSummary {
  TsdfBackend backend = TsdfBackend::kCpu;  ///< the one that ran.
  std::string device;                       ///< the GPU's name, or the number of threads.
  double voxel_size = 0;
  double truncation = 0;
  int num_views = 0;  ///< with any depth that counts.
  int64_t num_blocks = 0;
  int64_t num_depths = 0;    ///< that count.
  int64_t num_outliers = 0;  ///< of these, dropped because they lie far from all others.
  uint64_t predicted_bytes = 0;
  double prepare_seconds = 0;  ///< reading the views, choosing the grid, finding the blocks.
  double fuse_seconds = 0;     ///< updating the voxels.
};

class TsdfViewCache;
struct TsdfView;
struct TsdfDepthTiles;

/// Depth maps fused into a surface. The CPU's result is bit-identical for any number of threads.
class TsdfFusion {
 public:
  /// Reads the views and plans the grid. Throws UserError when no view has a depth that counts, for views
  /// whose sizes do not fit together, when the memory would not suffice (the message says which voxel size
  /// would), and when CUDA is asked for and there is none.
  /// \param source  must outlive the fusion.
  TsdfFusion(const DepthViewSource& source, const TsdfOptions& options, Reporter& reporter);
  ~TsdfFusion();
  TsdfFusion(const TsdfFusion&) = delete;
  TsdfFusion& operator=(const TsdfFusion&) = delete;

  TsdfVolume Fuse();

  /// Gives each vertex the mean colour of the views that see it, weighted as their depths are; black where no
  /// view with colours does. Nothing happens when no view has colours. \param mesh  in the object's frame.
  void ColorVertices(TriangleMesh* mesh) const;

  const TsdfSummary& summary() const { return summary_; }

 private:
  void PlanGrid();
  void FindBlocks();
  void AddColors(const std::vector<const TsdfView*>& views, const std::vector<TsdfViewParams>& params,
                 const std::vector<TsdfDepthTiles>& tiles, const Eigen::Vector3f* vertices, int size,
                 Eigen::Array4f* sums) const;
  uint64_t BytesNeeded(uint64_t num_blocks) const;
  [[noreturn]] void FailMemory(uint64_t num_blocks) const;

  TsdfOptions options_;
  Reporter& reporter_;
  std::unique_ptr<TsdfViewCache> views_;
  Eigen::AlignedBox3d region_;  // in the object's frame: what lies outside are outliers
  Eigen::Vector3d origin_ = Eigen::Vector3d::Zero();
  TsdfBlockIndex blocks_;
  TsdfVoxelParams voxel_params_{};
  TsdfSummary summary_;
};

/// The whole way from depth maps to a coloured mesh with normals, in the object's frame.
/// \param summary  may be null.
TriangleMesh MeshFromDepthMaps(const DepthViewSource& source, const TsdfOptions& options, Reporter& reporter,
                               TsdfSummary* summary = nullptr);

}  // namespace s2gs
