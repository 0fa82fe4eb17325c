#include "s2gs/cpu/gaussian_pass.h"

#include <algorithm>

#include "s2gs/backend/splat_camera.h"
#include "s2gs/kernel/intersect.h"
#include "s2gs/kernel/sh.h"

namespace s2gs {
namespace {

constexpr float kCutoffSlack = 1.0005F;  // over rounding of the logarithm and the exponential.

SurfelParameters<float> LoadSurfel(const Gaussians& g, size_t i) {
  SurfelParameters<float> s;
  s.centre = {g.centre[3 * i], g.centre[3 * i + 1], g.centre[3 * i + 2]};
  s.log_scale = {g.log_scale[2 * i], g.log_scale[2 * i + 1]};
  s.rotation = {g.rotation[4 * i], g.rotation[4 * i + 1], g.rotation[4 * i + 2], g.rotation[4 * i + 3]};
  s.opacity_logit = g.opacity_logit[i];
  s.foreground_logit = g.foreground_logit[i];
  return s;
}

Footprint<float> ToFootprint(const SplatRow& row) {
  return {{row.x, row.y},   {row.ux, row.uy}, {row.vx, row.vy},
          {row.wx, row.wy}, row.depth,        {row.nx, row.ny, row.nz}};
}

}  // namespace

ViewSetup MakeViewSetup(const PinholeView& view, SceneBodies bodies, bool freeze_foreground, int sh_degree) {
  ViewSetup setup;
  setup.camera = ToSplatCamera(view);
  setup.rule = RuleFor(bodies, freeze_foreground);
  setup.sh_degree = sh_degree;
  return setup;
}

bool ProjectGaussian(const Gaussians& gaussians, size_t i, const ViewSetup& setup, SplatRow* row) {
  row->x_begin = row->x_end = row->y_begin = row->y_end = 0;
  const SurfelParameters<float> g = LoadSurfel(gaussians, i);
  const bool is_foreground = IsForeground(g.foreground_logit, setup.rule);
  const float* dc = gaussians.sh_dc.data() + 3 * i;
  const Vec3<float> base_color = ShBaseColor(Vec3<float>{dc[0], dc[1], dc[2]});
  if (!IsSelected(setup.selection, g.centre, base_color, is_foreground)) return false;
  Surfel<float> surfel;
  Footprint<float> footprint;
  PixelRect rect;
  if (!TransformSurfel(g, setup.camera, setup.rule, &surfel)) return false;
  if (!ComputeFootprint(surfel, setup.camera, &footprint)) return false;
  if (!BoundSplat(surfel, footprint, setup.camera, &rect)) return false;
  const float* rest = gaussians.sh_rest.data() + 3 * kShRestPerChannel * i;
  const Vec3<float> color = ShColor(
      setup.sh_degree, Vec3<float>{dc[0], dc[1], dc[2]},
      [rest](int k, int channel) { return rest[3 * k + channel]; }, surfel.view_direction);
  constexpr auto kMax = static_cast<float>(kMaxColor);
  if (!(color.x < kMax && color.y < kMax && color.z < kMax)) return false;
  row->x = footprint.centre.x;
  row->y = footprint.centre.y;
  row->ux = footprint.u.x;
  row->uy = footprint.u.y;
  row->vx = footprint.v.x;
  row->vy = footprint.v.y;
  row->wx = footprint.w.x;
  row->wy = footprint.w.y;
  row->depth = footprint.depth;
  row->nx = footprint.normal.x;
  row->ny = footprint.normal.y;
  row->nz = footprint.normal.z;
  row->opacity = surfel.opacity;
  row->red = color.x;
  row->green = color.y;
  row->blue = color.z;
  const bool is_rotating = CountsAsRotating(setup.selection, g.centre, base_color, is_foreground);
  row->foreground = setup.hard_map ? (is_rotating ? 1.0F : 0.0F) : surfel.foreground;
  row->cutoff2 = CutoffSquaredRadius(surfel.opacity) * kCutoffSlack + 1e-4F;
  row->x_begin = rect.x_begin;
  row->y_begin = rect.y_begin;
  row->x_end = rect.x_end;
  row->y_end = rect.y_end;
  return true;
}

void GaussianGradients::Resize(size_t count) {
  centre.resize(3 * count);
  log_scale.resize(2 * count);
  rotation.resize(4 * count);
  opacity_logit.resize(count);
  sh_dc.resize(3 * count);
  sh_rest.resize(3 * kShRestPerChannel * count);
  foreground_logit.resize(count);
}

void GaussianGradients::SetZero() {
  for (std::vector<float>* rows :
       {&centre, &log_scale, &rotation, &opacity_logit, &sh_dc, &sh_rest, &foreground_logit}) {
    std::fill(rows->begin(), rows->end(), 0.0F);
  }
}

void ProjectGaussianAdjoint(const Gaussians& gaussians, size_t i, const ViewSetup& setup, const SplatRow& row,
                            const SplatGradient& d_row, size_t at, GaussianGradients* gradients) {
  const SurfelParameters<float> g = LoadSurfel(gaussians, i);
  Surfel<float> surfel;
  if (!TransformSurfel(g, setup.camera, setup.rule, &surfel)) return;
  Surfel<float> d_surfel{};
  d_surfel.opacity = d_row.opacity;
  d_surfel.foreground = d_row.foreground;
  const Footprint<float> d_footprint = {{d_row.x, d_row.y},   {d_row.ux, d_row.uy},
                                        {d_row.vx, d_row.vy}, {d_row.wx, d_row.wy},
                                        d_row.depth,          {d_row.nx, d_row.ny, d_row.nz}};
  ComputeFootprintAdjoint(surfel, setup.camera, ToFootprint(row), d_footprint, &d_surfel);

  const float* rest = gaussians.sh_rest.data() + 3 * kShRestPerChannel * i;
  float* d_rest = gradients->sh_rest.data() + 3 * kShRestPerChannel * at;
  Vec3<float> d_dc;
  d_surfel.view_direction = ShColorAdjoint(
      setup.sh_degree, [rest](int k, int channel) { return rest[3 * k + channel]; }, surfel.view_direction,
      Vec3<float>{row.red, row.green, row.blue}, Vec3<float>{d_row.red, d_row.green, d_row.blue}, &d_dc,
      [d_rest](int k, const Vec3<float>& d) {
        d_rest[3 * k] = d.x;
        d_rest[3 * k + 1] = d.y;
        d_rest[3 * k + 2] = d.z;
      });
  const SurfelParameters<float> d = TransformSurfelAdjoint(g, setup.camera, setup.rule, surfel, d_surfel);
  float* centre = gradients->centre.data() + 3 * at;
  centre[0] = d.centre.x;
  centre[1] = d.centre.y;
  centre[2] = d.centre.z;
  gradients->log_scale[2 * at] = d.log_scale.x;
  gradients->log_scale[2 * at + 1] = d.log_scale.y;
  float* rotation = gradients->rotation.data() + 4 * at;
  rotation[0] = d.rotation.w;
  rotation[1] = d.rotation.x;
  rotation[2] = d.rotation.y;
  rotation[3] = d.rotation.z;
  gradients->opacity_logit[at] = d.opacity_logit;
  float* dc = gradients->sh_dc.data() + 3 * at;
  dc[0] = d_dc.x;
  dc[1] = d_dc.y;
  dc[2] = d_dc.z;
  gradients->foreground_logit[at] = d.foreground_logit;
}

}  // namespace s2gs
