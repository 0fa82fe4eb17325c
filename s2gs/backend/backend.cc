#include "s2gs/backend/backend.h"

namespace s2gs {

const char* BackendName(BackendKind kind) { return kind == BackendKind::kCuda ? "CUDA" : "CPU"; }

DrawnSelection<float> SelectionOf(const RenderRequest& request) {
  const auto to_vec = [](const Eigen::Vector3d& v) {
    return Vec3<float>{static_cast<float>(v.x()), static_cast<float>(v.y()), static_cast<float>(v.z())};
  };
  DrawnSelection<float> selection;
  selection.body = request.drawn;
  const auto to_cylinder = [&](const RotatingRegion& region) {
    return AxisCylinder<float>{to_vec(region.axis.point), to_vec(region.axis.direction),
                               static_cast<float>(region.radius), static_cast<float>(region.low),
                               static_cast<float>(region.high)};
  };
  if (request.without_static) selection.without_static = to_cylinder(*request.without_static);
  if (request.side) {
    const RotatingSide& side = *request.side;
    selection.side = {to_cylinder(side.region),
                      static_cast<float>(side.inner_radius),
                      {side.color[0], side.color[1], side.color[2]},
                      side.color_tolerance};
  }
  return selection;
}

TrainState SelectState(const TrainState& state, const std::vector<uint32_t>& indices) {
  const auto select = [&](const std::vector<float>& values) {
    std::vector<float> chosen;
    if (values.empty()) return chosen;
    chosen.reserve(indices.size());
    for (const uint32_t index : indices) chosen.push_back(values[index]);
    return chosen;
  };
  TrainState chosen;
  chosen.gaussians = SelectGaussians(state.gaussians, indices);
  if (!state.first_moment.empty()) {
    chosen.first_moment = SelectGaussians(state.first_moment, indices);
    chosen.second_moment = SelectGaussians(state.second_moment, indices);
  }
  chosen.gradient_sum = select(state.gradient_sum);
  chosen.view_count = select(state.view_count);
  return chosen;
}

Placement Backend::GetPlacement() const {
  Gaussians gaussians = GetGaussians();
  return {std::move(gaussians.centre), std::move(gaussians.foreground_logit)};
}

void Backend::Keep(const std::vector<uint32_t>& indices) { SetState(SelectState(GetState(), indices)); }

void Backend::SetForegroundLogits(const std::vector<float>& logits) {
  TrainState state = GetState();
  std::vector<float>& old = state.gaussians.foreground_logit;
  S2GS_INVARIANT(logits.size() == old.size());
  for (size_t i = 0; i < old.size(); ++i) {
    if (old[i] == logits[i]) continue;
    if (!state.first_moment.empty()) {
      state.first_moment.foreground_logit[i] = 0;
      state.second_moment.foreground_logit[i] = 0;
    }
    old[i] = logits[i];
  }
  SetState(state);
}

}  // namespace s2gs
