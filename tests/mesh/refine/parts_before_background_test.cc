#include "mesh/refine/parts_before_background.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include "mesh/refine/vertex_visibility.h"
#include "sfm_split/base/angles.h"
#include "tests/mesh/refine/sphere_photos.h"

namespace s2gs {
namespace {

constexpr uint8_t kClay = 150;

// A mesh of spheres, each a part.
struct Parts {
  TriangleMesh mesh;
  std::vector<int> of_triangle;

  void Add(double radius, const Eigen::Vector3f& middle) {
    const auto first = static_cast<uint32_t>(mesh.vertices.size());
    const TriangleMesh sphere = Sphere(radius, 40);
    const int part = of_triangle.empty() ? 0 : of_triangle.back() + 1;
    for (const Eigen::Vector3f& vertex : sphere.vertices) mesh.vertices.push_back(vertex + middle);
    for (const Triangle& triangle : sphere.triangles) {
      mesh.triangles.emplace_back(first + triangle[0], first + triangle[1], first + triangle[2]);
      of_triangle.push_back(part);
    }
  }
};

// Photos of plain clay before a pattern that stands still, of a camera that does, too; each photo has an
// exposure of its own. \param brightness  of triangles; empty: all are clay. Of the pattern's blocks two in
// three are as bright as the last.
class ClayPhotos : public RefinementPhotoSource {
 public:
  ClayPhotos(const TriangleMesh& clay, int count, bool is_background_clay = false,
             const std::vector<int>& brightness = {}) {
    std::mt19937 random(1);
    const auto uniform = [&](int low, int high) {
      return std::uniform_int_distribution<>(low, high)(random);
    };
    std::vector<int> background(static_cast<size_t>(kSide) * kSide, kClay);
    for (int block = 0; !is_background_clay && block < kSide / 8 * (kSide / 8); ++block) {
      const int value = !brightness.empty() && block % 3 > 0 ? brightness.back() : uniform(20, 200);
      for (int y = 0; y < 8; ++y) {
        for (int x = 0; x < 8; ++x)
          background[(block / (kSide / 8) * 8 + y) * kSide + block % (kSide / 8) * 8 + x] = value;
      }
    }
    for (int i = 0; i < count; ++i) {
      views_.push_back(LookAtMiddle(2 * kPi * i / count, 0.3));
      std::vector<int32_t> triangles;
      RenderMeshDepth(clay, views_.back(), &triangles);
      Image8 photo{kSide, kSide, 1, {}};
      const double gain = 1 + 0.2 * std::sin(5.0 * i);
      for (size_t at = 0; at < triangles.size(); ++at) {
        const int of_clay = brightness.empty() || triangles[at] < 0 ? kClay : brightness[triangles[at]];
        const int value = triangles[at] >= 0 ? of_clay : background[at];
        photo.pixels.push_back(static_cast<uint8_t>(std::clamp(gain * value + uniform(-2, 2), 0.0, 255.0)));
      }
      photos_.push_back(std::move(photo));
    }
  }
  int size() const override { return static_cast<int>(views_.size()); }
  const ObjectView& Camera(int index) const override { return views_[index]; }
  Image8 Load(int index) const override {
    if (!may_load) ADD_FAILURE() << "photo " << index << " is loaded";
    ++num_loaded;
    return photos_[index];
  }

  bool may_load = true;
  mutable std::atomic<int> num_loaded{0};

 private:
  std::vector<ObjectView> views_;
  std::vector<Image8> photos_;
};

std::vector<PartSight> Judge(const ClayPhotos& photos, const Parts& parts, int station, int num_threads = 2) {
  Reporter silent;
  const PartsBeforeBackground judge(photos, std::vector<int>(photos.size(), station), num_threads, silent);
  return judge.Judge(parts.mesh, parts.of_triangle);
}

// A body, a small part beside it, and a scrap that no photo shows.
Parts BodyPartAndScrap(Parts* clay) {
  Parts parts;
  parts.Add(0.5, {0.15F, 0, 0});
  parts.Add(0.06, {0.8F, 0, 0.2F});
  *clay = parts;
  parts.Add(0.06, {-0.6F, 0.6F, -0.1F});
  return parts;
}

TEST(PartsBeforeBackground, AreThereWherePhotosDifferFromIt) {
  Parts clay;
  const Parts parts = BodyPartAndScrap(&clay);
  const ClayPhotos photos(clay.mesh, 12);
  const std::vector<PartSight> expected = {PartSight::kUnknown, PartSight::kThere, PartSight::kNotThere};
  EXPECT_EQ(Judge(photos, parts, 0), expected);
  EXPECT_EQ(Judge(photos, parts, 3, 1), expected);
}

// A round body in the middle of the table hides the same pixels in all photos: what is there is told all the
// same, but nothing is refuted.
TEST(PartsBeforeBackground, AreToldBesideABodyThatHidesItsBackground) {
  Parts clay;
  clay.Add(0.5, {0, 0, 0});
  clay.Add(0.06, {0.8F, 0, 0.2F});
  Parts parts = clay;
  parts.Add(0.06, {-0.6F, 0.6F, -0.1F});
  const std::vector<PartSight> sights = Judge(ClayPhotos(clay.mesh, 12), parts, 0);
  EXPECT_EQ(sights, (std::vector<PartSight>{PartSight::kUnknown, PartSight::kThere, PartSight::kUnknown}));
}

TEST(PartsBeforeBackground, OfNoNumberAreNotJudged) {
  Parts clay;
  Parts parts = BodyPartAndScrap(&clay);
  for (int& part : parts.of_triangle) part = part == 1 ? -1 : part;
  const std::vector<PartSight> sights = Judge(ClayPhotos(clay.mesh, 12), parts, 0);
  EXPECT_EQ(sights, (std::vector<PartSight>{PartSight::kUnknown, PartSight::kUnknown, PartSight::kNotThere}));
}

// A background that cannot be told from the body says nothing, and neither do too few photos.
TEST(PartsBeforeBackground, AreUnknownWhereNothingTells) {
  Parts clay;
  const Parts parts = BodyPartAndScrap(&clay);
  const std::vector<PartSight> unknown(3, PartSight::kUnknown);
  EXPECT_EQ(Judge(ClayPhotos(clay.mesh, 12, true), parts, 0), unknown);
  EXPECT_EQ(Judge(ClayPhotos(clay.mesh, 7), parts, 0), unknown);
}

// Before most of its background a body looks as if nothing were there; it is told by the rest.
TEST(PartsBeforeBackground, AreThereThoughMostOfTheBackgroundIsAsBright) {
  Parts clay;
  clay.Add(0.5, {0.15F, 0, 0});
  clay.Add(0.2, {0.8F, 0, 0.2F});
  std::vector<int> brightness;
  for (const int part : clay.of_triangle) brightness.push_back(part == 0 ? 250 : 110);
  const ClayPhotos photos(clay.mesh, 24, false, brightness);
  EXPECT_EQ(Judge(photos, clay, 0), (std::vector<PartSight>{PartSight::kUnknown, PartSight::kThere}));
}

// All of a station are held in memory at once.
TEST(PartsBeforeBackground, AreJudgedByAHundredPhotosAtMost) {
  Parts clay;
  const Parts parts = BodyPartAndScrap(&clay);
  const ClayPhotos photos(clay.mesh, 130);
  EXPECT_EQ(Judge(photos, parts, 0),
            (std::vector<PartSight>{PartSight::kUnknown, PartSight::kThere, PartSight::kNotThere}));
  EXPECT_EQ(photos.num_loaded, 100);
}

TEST(PartsBeforeBackground, CostNothingWhereThereIsNothingToJudge) {
  Parts clay;
  const Parts parts = BodyPartAndScrap(&clay);
  ClayPhotos photos(clay.mesh, 12);
  photos.may_load = false;
  // Cameras by themselves; a body alone; a part of less than the pixels that a vote needs.
  EXPECT_EQ(Judge(photos, parts, -1), std::vector<PartSight>(3, PartSight::kUnknown));
  Parts body;
  body.Add(0.5, {0, 0, 0});
  EXPECT_EQ(Judge(photos, body, 0), std::vector<PartSight>(1, PartSight::kUnknown));
  body.Add(0.5 * kPixel, {0.8F, 0, 0.2F});
  EXPECT_EQ(Judge(photos, body, 0), std::vector<PartSight>(2, PartSight::kUnknown));
  EXPECT_TRUE(Judge(photos, Parts(), 0).empty());
}

// Part of what stands behind a body in all photos, as a hidden scrap does, has no vote.
TEST(PartsBeforeBackground, AreUnknownWhereTheyAreNowhereAlone) {
  Parts clay;
  clay.Add(0.5, {0, 0, 0});
  Parts parts = clay;
  parts.Add(0.1, {0, 0, 0});
  EXPECT_EQ(Judge(ClayPhotos(clay.mesh, 12), parts, 0), std::vector<PartSight>(2, PartSight::kUnknown));
}

}  // namespace
}  // namespace s2gs
