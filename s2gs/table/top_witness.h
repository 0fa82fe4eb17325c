#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "s2gs/table/photo_table.h"
#include "s2gs/table/plain_top.h"
#include "s2gs/train.h"
#include "s2gs/training_scene.h"

namespace s2gs {

/// A table's plain top as a witness of training: photos tell nothing of its depth, so that training builds
/// layers above it, of which it then makes the foot of what stands there, too. They go while it can still put
/// what photos show elsewhere.
class TopWitness : public GaussianWitness {
 public:
  /// \param scene  outlives this.
  explicit TopWitness(const TrainingScene& scene) : scene_(scene) {}

  /// FindLayersOverTop's; none where the photos show no plain top. Throws Interrupted.
  std::vector<uint32_t> FindRefuted(Backend* backend, Reporter& reporter) override;
  std::string Reason() const override { return "where photos show the table's plain top"; }

 private:
  void Learn(Reporter& reporter);

  const TrainingScene& scene_;
  bool has_learnt_ = false;
  std::vector<StationPhotos> stations_;
  std::optional<PlainTop> top_;
};

}  // namespace s2gs
