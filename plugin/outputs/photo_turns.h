#pragma once

#include <Eigen/Core>
#include <map>
#include <string>
#include <vector>

#include "plugin/outputs/dense_views.h"
#include "plugin/stage/workspace.h"

namespace s2gs {

/// How the table stands in each photo (world_from_object); as if it stood still where turntable.json does not
/// say it of all views.
class PhotoTurns {
 public:
  PhotoTurns(const Workspace& workspace, const std::vector<DenseViewFiles>& views);

  Eigen::Matrix3d Of(const std::string& name) const;

 private:
  std::map<std::string, Eigen::Matrix3d> turns_;
};

}  // namespace s2gs
