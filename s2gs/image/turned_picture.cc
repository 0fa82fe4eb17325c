#include "s2gs/image/turned_picture.h"

#include <array>
#include <cmath>
#include <cstddef>

#include "s2gs/image/bilinear.h"

namespace s2gs {

PinholeView TurnedTo(const PinholeView& other, const PinholeView& view) {
  const Rigid3 turn = {other.cam_from_world.rotation * view.cam_from_world.rotation.conjugate(),
                       Eigen::Vector3d::Zero()};
  PinholeView turned = view;
  turned.cam_from_world = turn * view.cam_from_world;
  turned.cam_from_object = turn * view.cam_from_object;
  return turned;
}

Image8 TurnedPicture(const PinholeView& view, const PinholeView& turned, const Image8& picture,
                     std::vector<uint8_t>* is_outside) {
  const Eigen::Matrix3d from_turned =
      (view.cam_from_world.rotation * turned.cam_from_world.rotation.conjugate()).toRotationMatrix();
  Image8 result = picture;
  if (is_outside != nullptr) is_outside->assign(static_cast<size_t>(picture.width) * picture.height, 0);
  for (int y = 0; y < picture.height; ++y) {
    for (int x = 0; x < picture.width; ++x) {
      const Eigen::Vector3d ray = from_turned * Eigen::Vector3d((x + 0.5 - turned.cx) / turned.fx,
                                                                (y + 0.5 - turned.cy) / turned.fy, 1);
      const Eigen::Vector2d at(view.cx + view.fx * ray.x() / ray.z(), view.cy + view.fy * ray.y() / ray.z());
      if (!(ray.z() > 0 && at.x() >= 0.5 && at.y() >= 0.5 && at.x() < picture.width - 0.5 &&
            at.y() < picture.height - 0.5)) {
        if (is_outside != nullptr) (*is_outside)[static_cast<size_t>(y) * picture.width + x] = 1;
        continue;
      }
      const std::array<float, 3> color = BilinearColor(picture, at);
      for (int c = 0; c < 3; ++c) result.Pixel(x, y)[c] = static_cast<uint8_t>(std::lround(color[c]));
    }
  }
  return result;
}

}  // namespace s2gs
