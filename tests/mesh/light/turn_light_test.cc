#include "mesh/light/turn_light.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "mesh/light/light_transfer.h"
#include "mesh/surface/vertex_normals.h"
#include "mesh/texture/texture_mesh.h"
#include "sfm_split/base/angles.h"
#include "tests/mesh/texture/box_photos.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

Eigen::Matrix3d TurnAboutZ(double degrees) {
  return Eigen::AngleAxisd(degrees * kPi / 180, Eigen::Vector3d::UnitZ()).toRotationMatrix();
}

// A tube of radius 1 along z with a floor at 0, its inside outwards.
TriangleMesh Well(double depth, int sides) {
  TriangleMesh mesh;
  mesh.vertices.emplace_back(0, 0, 0);
  for (const double z : {0.0, depth}) {
    for (int i = 0; i < sides; ++i) {
      const double angle = 2 * kPi * i / sides;
      mesh.vertices.push_back(Eigen::Vector3d(std::cos(angle), std::sin(angle), z).cast<float>());
    }
  }
  for (int i = 0; i < sides; ++i) {
    const uint32_t a = 1 + i;
    const uint32_t b = 1 + (i + 1) % sides;
    mesh.triangles.emplace_back(0, a, b);
    mesh.triangles.emplace_back(a, a + sides, b);
    mesh.triangles.emplace_back(b, a + sides, b + sides);
  }
  ComputeNormals(&mesh);
  return mesh;
}

// Its floor's middle sees a cone of the sky: the integral of the cosine is pi sin^2 of its half angle.
TEST(LightTransfer, WallsHideTheSkyByTheClosedForm) {
  for (const double depth : {0.3, 1.0, 2.0}) {
    const TriangleMesh mesh = Well(depth, 64);
    const LightTransfer transfer(mesh, 0);
    const double expected = kPi / (1 + depth * depth);
    const double measured = transfer.At(0, 1, 0)[0] / LightHarmonics(Eigen::Vector3f::UnitZ())[0];
    // Of 192 directions some lie on the cones' edges; measured: .007, .013 and .0001 of pi.
    EXPECT_NEAR(measured, expected, 0.02 * kPi);
  }
}

// The box's faces apart, so that each has its own normals.
TriangleMesh FacesOf(const PaintedBox& box) {
  const TriangleMesh shared = MeshOf({box});
  TriangleMesh mesh;
  for (const Triangle& corners : shared.triangles) {
    const auto first = static_cast<uint32_t>(mesh.vertices.size());
    for (int i = 0; i < 3; ++i) mesh.vertices.push_back(shared.vertices[corners[i]]);
    mesh.triangles.emplace_back(first, first + 1, first + 2);
  }
  return mesh;
}

// A floor of two large triangles beside a wall: the light of an even sky anywhere on it, against the integral
// over the directions that miss the wall.
TEST(LightTransfer, ShadowsEndWithinLargeTriangles) {
  constexpr float kLong = 2;
  constexpr float kWide = 3;
  constexpr float kHigh = 1;
  TriangleMesh mesh;
  mesh.vertices = {{0, -kLong, 0}, {kWide, -kLong, 0}, {kWide, kLong, 0}, {0, kLong, 0},
                   {0, -kLong, 0}, {0, kLong, 0},      {0, kLong, kHigh}, {0, -kLong, kHigh}};
  mesh.triangles = {{0, 1, 2}, {0, 2, 3}, {4, 5, 6}, {4, 6, 7}};
  ComputeNormals(&mesh);
  const LightTransfer transfer(mesh, 0);
  const auto open_sky = [&](const Eigen::Vector3f& x) {
    constexpr int kDirections = 20000;
    double sum = 0;
    for (int i = 0; i < kDirections; ++i) {
      const double z = (i + 0.5) / kDirections;
      const double angle = kPi * (1 + std::sqrt(5.0)) * i;
      const Eigen::Vector3d d(std::sqrt(1 - z * z) * std::cos(angle), std::sqrt(1 - z * z) * std::sin(angle),
                              z);
      const double t = d.x() < 0 ? -x.x() / d.x() : 1e9;  // to the wall's plane
      const bool hits = std::abs(x.y() + t * d.y()) < kLong && t * z < kHigh;
      sum += hits ? 0 : z;
    }
    return 2 * kPi * sum / kDirections;
  };
  const LightTerms up = LightHarmonics(Eigen::Vector3f::UnitZ());
  for (const uint32_t triangle : {0U, 1U}) {
    for (const auto& [u, v] : {std::pair(0.2F, 0.3F), std::pair(0.6F, 0.1F), std::pair(0.1F, 0.75F),
                               std::pair(0.05F, 0.05F), std::pair(0.33F, 0.5F)}) {
      const Triangle& corners = mesh.triangles[triangle];
      const Eigen::Vector3f x = u * mesh.vertices[corners[0]] + v * mesh.vertices[corners[1]] +
                                (1 - u - v) * mesh.vertices[corners[2]];
      if (x.x() < 0.1F) continue;  // places are raised by two pixels of .01
      // 192 directions: measured .04 at most.
      EXPECT_NEAR(transfer.At(triangle, u, v)[0] / up[0], open_sky(x), 0.08)
          << triangle << " " << u << " " << v;
    }
  }
}

TEST(LightTransfer, ConvexSurfacesSeeAllThatIsAboveThem) {
  TriangleMesh mesh = FacesOf({{-0.5, -0.4, -0.3}, {0.5, 0.4, 0.3}, {}});
  ComputeNormals(&mesh);
  const LightTransfer transfer(mesh, 0);
  for (uint32_t t = 0; t < mesh.triangles.size(); ++t) {
    const Triangle& corners = mesh.triangles[t];
    const auto corner = [&](int i) { return mesh.vertices[corners[i]]; };
    const Eigen::Vector3f normal = (corner(1) - corner(0)).cross(corner(2) - corner(0)).normalized();
    const LightTerms error = transfer.At(t, 0.31F, 0.27F) - OpenTransfer(normal);
    // 192 directions add up to the integrals within .0024.
    EXPECT_LT(error.cwiseAbs().maxCoeff(), 0.01) << t;
  }
}

// Light that is brighter from one side and bluish from another; no more than bands 0 and 1.
Eigen::Matrix<double, kLightTerms, 3> World() {
  Eigen::Matrix<double, kLightTerms, 3> light = Eigen::Matrix<double, kLightTerms, 3>::Zero();
  light.row(0).setOnes();
  light.row(1) << 0.3, 0.25, 0.1;
  light.row(2) << 0.3, 0.3, 0.4;
  light.row(3) << -0.35, -0.35, -0.2;
  return light;
}

// The irradiance of a normal in the world by hand: 1 + a z with harmonics of band 1 is pi Y0 + 2 pi / 3 a Y1
// n.
Eigen::Array3d IrradianceByHand(const Eigen::Vector3d& n) {
  const auto light = World();
  const double c1 = 0.4886025119029199;
  Eigen::Array3d sum;
  for (int c = 0; c < 3; ++c) {
    sum[c] = kPi * 0.28209479177387814 * light(0, c) +
             2 * kPi / 3 * c1 * (-n.y() * light(1, c) + n.z() * light(2, c) - n.x() * light(3, c));
  }
  return sum;
}

TEST(TurnLight, ShadesAreIrradianceBesideItsMean) {
  std::vector<Eigen::Matrix3d> turns;
  for (int i = 0; i < 8; ++i) turns.push_back(TurnAboutZ(45 * i));
  const TurnLight light(World(), turns);
  RandomNumbers random(1);
  for (int k = 0; k < 20; ++k) {
    const Eigen::Vector3d normal =
        Eigen::Vector3d(random.Uniform(-1, 1), random.Uniform(-1, 1), random.Uniform(-1, 1)).normalized();
    Eigen::Array3d mean = Eigen::Array3d::Zero();
    for (const Eigen::Matrix3d& turn : turns) mean += IrradianceByHand(turn * normal) / 8;
    const Eigen::Array3d expected = IrradianceByHand(turns[3] * normal) / mean;
    const Eigen::Array3f shade = light.Shade(light.Turned(turns[3]), OpenTransfer(normal.cast<float>()));
    EXPECT_LT((shade.cast<double>() - expected).abs().maxCoeff(), 1e-5);
  }
}

// Places of random colours and normals, each seen in half of the photos, with noise and with gloss in some.
TEST(FitTurnLight, FindsTheLightThatSamplesWereMadeWith) {
  std::vector<Eigen::Matrix3d> turns;
  for (int i = 0; i < 24; ++i) turns.push_back(TurnAboutZ(15 * i));
  const TurnLight truth(World(), turns);
  for (const bool is_lit : {true, false}) {
    RandomNumbers random(2);
    std::vector<LitSample> samples;
    std::vector<LightTerms> transfers;
    for (uint32_t k = 0; k < 3000; ++k) {
      const Eigen::Vector3f normal =
          Eigen::Vector3d(random.Uniform(-1, 1), random.Uniform(-1, 1), random.Uniform(-1, 1))
              .normalized()
              .cast<float>();
      transfers.push_back(OpenTransfer(normal));
      const Eigen::Array3f color(random.Uniform(40, 150), random.Uniform(40, 150), random.Uniform(40, 150));
      for (uint16_t p = 0; p < turns.size(); ++p) {
        if (random.Uniform(0, 1) < 0.5) continue;
        const Eigen::Array3f shade =
            is_lit ? truth.Shade(truth.Turned(turns[p]), transfers[k]) : Eigen::Array3f::Ones();
        Eigen::Array3f seen = UnderLight(color, shade) + static_cast<float>(random.Normal());
        if (random.Uniform(0, 1) < 0.05) seen += 60;
        samples.push_back({k, p, seen});
      }
    }
    const LightFinding found = FitTurnLight(samples, transfers, turns);
    double worst = 0;
    for (uint32_t k = 0; k < transfers.size(); k += 50) {
      for (const int p : {0, 5, 13}) {
        const Eigen::Array3f shade = found.light.Shade(found.light.Turned(turns[p]), transfers[k]);
        const Eigen::Array3f expected =
            is_lit ? truth.Shade(truth.Turned(turns[p]), transfers[k]) : Eigen::Array3f::Ones();
        worst = std::max<double>(worst, (shade - expected).abs().maxCoeff());
      }
    }
    RecordProperty(is_lit ? "worst_lit" : "worst_even", std::to_string(worst));
    EXPECT_LT(worst, 0.02);
    if (is_lit) {
      EXPECT_LT(found.error_lit, 0.25 * found.error_even);
    }
  }
  EXPECT_TRUE(FitTurnLight({}, {}, turns).light.is_even());
}

TEST(FitTurnLight, ATableThatStandsStillHasEvenLight) {
  const std::vector<Eigen::Matrix3d> turns(5, TurnAboutZ(30));
  std::vector<LitSample> samples;
  for (uint16_t p = 0; p < 5; ++p) samples.push_back({0, p, Eigen::Array3f::Constant(50.0F * p)});
  EXPECT_TRUE(FitTurnLight(samples, {OpenTransfer(Eigen::Vector3f::UnitX())}, turns).light.is_even());
}

// Photos of a box that turns under that light.
class LitBoxPhotos : public TexturePhotoSource {
 public:
  LitBoxPhotos(const PaintedBox& box, int count) {
    for (int i = 0; i < count; ++i) {
      const Eigen::Matrix3d turn = TurnAboutZ(360.0 * i / count);
      ObjectView view = LookAtOrigin(Eigen::Vector3d(4, 0, i % 2 == 0 ? 1.5 : 3.5), 200, 400);
      view.cam_from_object.rotation = view.cam_from_object.rotation * Eigen::Quaterniond(turn);
      PaintedBox lit = box;
      views_.push_back(view);
      turns_.push_back(turn);
      lit.color = [&](const Eigen::Vector3d& x) { return ColorAt(box, x, i); };
      photos_.push_back(BoxPhotos({lit}, {view}).Load(0));
    }
  }
  int size() const override { return static_cast<int>(views_.size()); }
  const ObjectView& Camera(int index) const override { return views_[index]; }
  Image8 Load(int index) const override { return photos_[index]; }
  Image8 LoadMask(int /*index*/) const override { return {}; }
  Eigen::Matrix3d WorldFromObject(int index) const override { return turns_[index]; }

  Eigen::Array3d ColorAt(const PaintedBox& box, const Eigen::Vector3d& x, int index) const {
    const Eigen::Vector3d normal = NormalAt(box, x);
    const Eigen::Array3d light = IrradianceByHand(turns_[index] * normal) / MeanLight(normal);
    return UnderLight(box.color(x).cast<float>(), light.cast<float>()).cast<double>();
  }
  static Eigen::Vector3d NormalAt(const PaintedBox& box, const Eigen::Vector3d& x) {
    const Eigen::Vector3d inside = (2 * x - box.low - box.high).cwiseQuotient(box.high - box.low);
    int axis = 0;
    inside.cwiseAbs().maxCoeff(&axis);
    return (inside[axis] > 0 ? 1.0 : -1.0) * Eigen::Vector3d::Unit(axis);
  }

 private:
  // Over a full turn band 1 leaves what is along z.
  static Eigen::Array3d MeanLight(const Eigen::Vector3d& normal) {
    return IrradianceByHand({0, 0, normal.z()});
  }

  std::vector<ObjectView> views_;
  std::vector<Image8> photos_;
  std::vector<Eigen::Matrix3d> turns_;
};

// The mean of what photos show of a place of a face, by the area that it has in them.
Eigen::Array3d SeenByHand(const LitBoxPhotos& photos, const PaintedBox& box, const Eigen::Vector3d& x) {
  const Eigen::Vector3d normal = LitBoxPhotos::NormalAt(box, x);
  Eigen::Array3d sum = Eigen::Array3d::Zero();
  double areas = 0;
  for (int i = 0; i < photos.size(); ++i) {
    const Eigen::Vector3d to_camera = CameraCentre(photos.Camera(i).cam_from_object) - x;
    const double area = std::max(0.0, normal.dot(to_camera.normalized())) / to_camera.squaredNorm();
    sum += area * photos.ColorAt(box, x, i);
    areas += area;
  }
  return sum / areas;
}

// One colour for each place is nearest to the photos as their mean; the light gives each photo's own back.
TEST(TextureMesh, ColorsAreTheMeanOfWhatPhotosShow) {
  const PaintedBox box = {{-0.6, -0.5, -0.4}, {0.6, 0.5, 0.5}, [](const Eigen::Vector3d& x) {
                            return Eigen::Array3d(110 + 40 * std::sin(9 * x.x()),
                                                  110 + 40 * std::sin(8 * x.y()),
                                                  110 + 40 * std::sin(7 * x.z()));
                          }};
  const LitBoxPhotos photos(box, 18);
  Reporter reporter;
  for (const bool unshade : {false, true}) {
    TextureOptions options;
    options.unshade = unshade;
    TextureSummary summary;
    TextureLight light;
    const TexturedMesh mesh = TextureMesh(FacesOf(box), photos, options, reporter, &summary, &light);
    double to_mean = 0;
    double to_photo = 0;
    double to_photo_lit = 0;
    int count = 0;
    for (const TexturePage& page : mesh.pages) {
      for (uint64_t t = page.first_triangle; t < page.first_triangle + page.num_triangles; ++t) {
        const Triangle& corners = mesh.triangles[t];
        Eigen::Vector3d x = Eigen::Vector3d::Zero();
        Eigen::Vector2f texel = Eigen::Vector2f::Zero();
        for (int i = 0; i < 3; ++i) {
          x += mesh.vertices[corners[i]].cast<double>() / 3;
          texel += mesh.texels[corners[i]] / 3;
        }
        if (LitBoxPhotos::NormalAt(box, x).z() < -0.5) continue;  // no photo shows it
        const uint8_t* pixel = page.image.Pixel(static_cast<int>(texel.x()), static_cast<int>(texel.y()));
        const Eigen::Array3f color(pixel[0], pixel[1], pixel[2]);
        to_mean += (color.cast<double>() - SeenByHand(photos, box, x)).square().sum();
        count += 3;
        if (!unshade) continue;
        const Eigen::Array3d in_photo = photos.ColorAt(box, x, 4);
        const PhotoLight here = light.light.Turned(photos.WorldFromObject(4));
        const Eigen::Array3f shade = light.Shade(here, mesh, static_cast<uint32_t>(t), 1.0F / 3, 1.0F / 3);
        to_photo += (color.cast<double>() - in_photo).square().sum();
        to_photo_lit += (UnderLight(color, shade).cast<double>() - in_photo).square().sum();
      }
    }
    EXPECT_EQ(count, 30);
    RecordProperty(unshade ? "rms" : "rms_without", std::to_string(std::sqrt(to_mean / count)));
    EXPECT_LT(std::sqrt(to_mean / count), 3);  // .7 with the light found, 1.6 without
    if (!unshade) continue;
    EXPECT_LT(summary.error_lit, 0.5 * summary.error_even);
    RecordProperty("rms_lit", std::to_string(std::sqrt(to_photo_lit / count)));
    EXPECT_LT(std::sqrt(to_photo_lit / count), 4);  // 2.1
    EXPECT_GT(std::sqrt(to_photo / count), 2 * std::sqrt(to_photo_lit / count));
  }
}

// Corners and edges of a triangle with values of its own are where its inside ends.
TEST(LightTransfer, HasNoJumpAtATrianglesCorners) {
  TriangleMesh mesh;
  mesh.vertices = {{0, -2, 0}, {3, -2, 0}, {3, 2, 0}, {0, 2, 0},
                   {0, -2, 0}, {0, 2, 0},  {0, 2, 1}, {0, -2, 1}};
  mesh.triangles = {{0, 1, 2}, {0, 2, 3}, {4, 5, 6}, {4, 6, 7}};
  ComputeNormals(&mesh);
  const LightTransfer transfer(mesh, 0);
  constexpr float kStep = 1e-4F;  // of an edge; the light differs by the order of it
  for (const uint32_t triangle : {0U, 1U}) {
    for (const auto& [u, v] : {std::pair(1.0F, 0.0F), std::pair(0.0F, 1.0F), std::pair(0.0F, 0.0F),
                               std::pair(0.5F, 0.5F), std::pair(0.25F, 0.75F)}) {
      const float inside_u = u + kStep * (1.0F / 3 - u);
      const float inside_v = v + kStep * (1.0F / 3 - v);
      const LightTerms off = transfer.At(triangle, u, v) - transfer.At(triangle, inside_u, inside_v);
      EXPECT_LT(off.cwiseAbs().maxCoeff(), 0.01) << triangle << ' ' << u << ' ' << v;
    }
  }
}

}  // namespace
}  // namespace s2gs
