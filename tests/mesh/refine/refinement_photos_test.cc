#include "mesh/refine/refinement_photos.h"

#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "mesh/surface/vertex_normals.h"
#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

constexpr int kSide = 200;       // of a photo [px]
constexpr double kFocal = 300;   // [px]
constexpr double kDistance = 7;  // of the nearer photos

// Photos that look down at the origin, from the left and from the right; and two from three times as far.
class NearAndFar : public RefinementPhotoSource {
 public:
  NearAndFar() {
    for (const double distance : {3 * kDistance, kDistance, kDistance, 3 * kDistance}) {
      ObjectView view{kSide, kSide, kFocal, 0.8 * kFocal, kSide / 2.0, kSide / 2.0, {}};
      const double turn = views_.size() % 2 == 0 ? 0.2 : -0.2;
      view.cam_from_object.rotation = Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitY()) *
                                      Eigen::AngleAxisd(3.141592653589793, Eigen::Vector3d::UnitX());
      view.cam_from_object.translation = {0, 0, distance};
      views_.push_back(view);
    }
  }
  int size() const override { return static_cast<int>(views_.size()); }
  const ObjectView& Camera(int index) const override { return views_[index]; }
  Image8 Load(int /*index*/) const override {
    return {kSide, kSide, 1, std::vector<uint8_t>(static_cast<size_t>(kSide) * kSide, 120)};
  }

 private:
  std::vector<ObjectView> views_;
};

// A level square of 5 x 5 squares of this side.
TriangleMesh Level(float side) {
  TriangleMesh mesh;
  for (int j = 0; j <= 5; ++j) {
    for (int i = 0; i <= 5; ++i)
      mesh.vertices.emplace_back(side * (static_cast<float>(i) - 2.5F), side * (static_cast<float>(j) - 2.5F),
                                 0);
  }
  for (uint32_t j = 0; j < 5; ++j) {
    for (uint32_t i = 0; i < 5; ++i) {
      const uint32_t at = 6 * j + i;
      mesh.triangles.emplace_back(at, at + 1, at + 6);
      mesh.triangles.emplace_back(at + 7, at + 6, at + 1);
    }
  }
  ComputeNormals(&mesh);
  return mesh;
}

// And one from amid the mesh, which sees an end of it and has its middle behind.
class NearFarAndWithin : public NearAndFar {
 public:
  explicit NearFarAndWithin(double half)
      : within_{kSide, kSide, kFocal, kFocal, kSide / 2.0, kSide / 2.0, {}} {
    Eigen::Matrix3d rotation;  // along x, .3 rad downwards
    rotation << 0, -1, 0, -std::sin(0.3), 0, -std::cos(0.3), std::cos(0.3), 0, -std::sin(0.3);
    within_.cam_from_object.rotation = Eigen::Quaterniond(rotation);
    within_.cam_from_object.translation = -rotation * Eigen::Vector3d(0.5 * half, 0, 0.1 * half);
  }
  int size() const override { return NearAndFar::size() + 1; }
  const ObjectView& Camera(int index) const override {
    return index < NearAndFar::size() ? NearAndFar::Camera(index) : within_;
  }

 private:
  ObjectView within_;
};

// By how much photos are shrunk, as the size of a pixel on the surface says.
double ShrinkFor(float side, const RefinementPhotoSource& source = NearAndFar()) {
  const TriangleMesh mesh = Level(side);
  Reporter silent;
  RefinementPhotos photos(1, silent);
  photos.Load(source, mesh, 1);
  EXPECT_EQ(photos.size(), source.size());
  const SurfacePatch patch = photos.PatchAt(mesh, 14, photos.FindVisible(mesh, {kMinSeenCosine, 0}), 4);
  double shrink = 0;
  for (int i = 0; i < patch.num_views; ++i) {
    const double depth =
        (patch.views[i]->center() - patch.middle).norm() > 2 * kDistance ? 3 * kDistance : kDistance;
    shrink = std::max(shrink, patch.views[i]->PixelSize(patch.middle) * kFocal / depth);
  }
  return shrink;
}

// A pixel of the nearest is no finer than a third of an edge; all are shrunk alike.
TEST(RefinementPhotos, AreAsFineAsTheMeshNeeds) {
  for (const int shrink : {1, 2, 3, 5}) {
    const double pixel = kDistance / kFocal;
    const double least = 3 * 2 * shrink * pixel;  // of an edge, for which a factor of one more is right
    EXPECT_NEAR(ShrinkFor(static_cast<float>(0.97 * least)), shrink, 0.1);
    EXPECT_NEAR(ShrinkFor(static_cast<float>(1.03 * least)), shrink + 1, 0.1 * shrink);
  }
}

// A photo that has the middle behind it says nothing of how fine the others are.
TEST(RefinementPhotos, HaveTheMeshBeforeThem) {
  const auto side = static_cast<float>(0.97 * 3 * 2 * kDistance / kFocal);
  EXPECT_NEAR(ShrinkFor(side, NearFarAndWithin(2.5 * side)), 1, 0.1);
}

// At a sixteenth of their size at most: then they fit, or they are refused.
TEST(RefinementPhotos, AreShrunkToASixteenthAtMost) {
  const TriangleMesh mesh = Level(0.4F);
  Reporter silent;
  RefinementPhotos photos(1, silent);
  try {
    photos.Load(NearAndFar(), mesh, 1e-9);
    FAIL();
  } catch (const UserError& error) {
    EXPECT_NE(std::string(error.what()).find("4 photos need "), std::string::npos) << error.what();
    EXPECT_NE(std::string(error.what()).find(" even at 0.0625 of their size"), std::string::npos)
        << error.what();
  }
}

// One photo that looks straight down, its principal point here [px].
class LookingDown : public RefinementPhotoSource {
 public:
  LookingDown(double cx, double cy) : view_{kSide, kSide, kFocal, kFocal, cx, cy, {}} {
    view_.cam_from_object.rotation = Eigen::AngleAxisd(3.141592653589793, Eigen::Vector3d::UnitX());
    view_.cam_from_object.translation = {0, 0, kDistance};
  }
  int size() const override { return 1; }
  const ObjectView& Camera(int /*index*/) const override { return view_; }
  Image8 Load(int /*index*/) const override {
    return {kSide, kSide, 1, std::vector<uint8_t>(static_cast<size_t>(kSide) * kSide, 120)};
  }

 private:
  ObjectView view_;
};

// With 16 pixels around it less than twice as many are hardly any, whichever side of the photo it passes.
TEST(RefinementPhotos, OfHardlyAnyOfTheMeshAreLeftOut) {
  const TriangleMesh mesh = Level(0.4F);
  const double half = 2.5 * 0.4 * kFocal / kDistance;  // of it in a photo [px]
  const auto is_taken = [&](double cx, double cy) {
    Reporter silent;
    RefinementPhotos photos(1, silent);
    photos.Load(LookingDown(cx, cy), mesh, 1);
    return photos.size() == 1;
  };
  constexpr double kMiddle = kSide / 2.0;
  EXPECT_TRUE(is_taken(kMiddle, kMiddle));
  for (const auto& [inside, expected] : {std::pair(10.0, false), std::pair(20.0, true)}) {
    EXPECT_EQ(is_taken(inside - half, kMiddle), expected);
    EXPECT_EQ(is_taken(kSide - inside + half, kMiddle), expected);
    EXPECT_EQ(is_taken(kMiddle, inside - half), expected);
    EXPECT_EQ(is_taken(kMiddle, kSide - inside + half), expected);
  }
}

}  // namespace
}  // namespace s2gs
