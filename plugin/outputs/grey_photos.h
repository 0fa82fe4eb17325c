#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "mesh/refine/mesh_refinement.h"
#include "plugin/outputs/dense_views.h"
#include "plugin/stage/workspace.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/scene/io/turntable_file.h"

namespace s2gs {

/// The photos of a workspace's dense views, grey, for what refines the mesh.
class GreyPhotos : public RefinementPhotoSource {
 public:
  /// \param seen_height  of a table's top where it is known in which pixels photos show it.
  explicit GreyPhotos(const std::vector<DenseViewFiles>& files, std::optional<double> seen_height = {})
      : photos_(files), seen_height_(seen_height) {}
  int size() const override { return photos_.size(); }
  const ObjectView& Camera(int index) const override { return photos_.Camera(index); }
  Image8 Load(int index) const override { return photos_.Load(index, 1); }
  Image8 LoadPlaneSeen(int index) const override;
  double SeenHeight() const override { return seen_height_.value_or(0); }
  Eigen::Matrix3d WorldFromObject(int index) const override;
  double Gain(int index) const override { return gains_.empty() ? 1 : gains_[index]; }

  /// How bright each photo is beside the others of its station (GreyGains). \param stations  StationsOf's.
  void FindGains(const std::vector<int>& stations, int num_threads);
  /// Tells how the table stands in each of the photos.
  void SetTurns(const Workspace& workspace, const std::vector<DenseViewFiles>& files);

 private:
  DensePhotos photos_;
  std::optional<double> seen_height_;
  std::vector<Eigen::Matrix3d> turns_;
  std::vector<double> gains_;
};

/// Of the views that have a photo, as GreyPhotos counts them; -1 where there is no table that turns.
std::vector<int> StationsOf(const std::optional<TurntableFile>& table,
                            const std::vector<DenseViewFiles>& files);

}  // namespace s2gs
