#include "sfm_split/turntable/align_scene.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <random>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/joint_system/joint_problem.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// Two models of one turntable: object in its own frame, background in its own frame and unit.
struct Models {
  ColmapModel object;
  ColmapModel background;
  std::map<std::string, int> station_of_image;
  double scale = 2.6;  // background units per object unit
  int stations = 3;
  int steps = 9;
  double step_deg = 23;

  void Build(uint32_t seed) {
    std::mt19937 rng(seed);
    std::normal_distribution<double> normal;
    const auto vector = [&] { return Vector3d(normal(rng), normal(rng), normal(rng)); };
    const Sim3 object_frame{1, Eigen::Quaterniond(ExpRotation<double>(vector())), vector()};
    const Sim3 background_frame{scale, Eigen::Quaterniond(ExpRotation<double>(vector())), vector()};
    Camera camera;
    camera.camera_id = 1;
    camera.params = {1, 1, 0, 0};  // observations are normalised
    object.cameras[1] = background.cameras[1] = camera;
    for (uint64_t i = 1; i <= 50; ++i) {
      ColmapPoint3D point;
      point.point3D_id = i;
      point.xyz = 0.1 * vector() + Vector3d(0, 0, 0.3);
      object.points3D[i] = point;
      point.xyz = 2 * vector();
      background.points3D[i] = point;
    }
    uint32_t id = 0;
    for (int s = 0; s < stations; ++s) {
      const double elevation = (20 + 15 * s) * kDegree;
      const Vector3d centre(0.1 + std::cos(elevation), -0.2, std::sin(elevation));
      Matrix3d world_from_cam;
      world_from_cam.col(2) = (Vector3d(0, 0, 0.2) - centre).normalized();
      world_from_cam.col(0) = world_from_cam.col(2).cross(Vector3d::UnitZ()).normalized();
      world_from_cam.col(1) = world_from_cam.col(2).cross(world_from_cam.col(0));
      const Rigid3 cam_from_world = Rigid3{Eigen::Quaterniond(world_from_cam), centre}.Inverse();
      for (int k = 0; k < steps; ++k) {
        ++id;
        ColmapImage image;
        image.image_id = id;
        image.camera_id = 1;
        char name[32];
        std::snprintf(name, sizeof(name), "s%d_%03d.jpg", s, k);
        image.name = name;
        station_of_image[name] = s;
        const Rigid3 turn{Eigen::Quaterniond(Eigen::AngleAxisd(k * step_deg * kDegree, Vector3d::UnitZ())),
                          Vector3d::Zero()};
        image.cam_from_world = cam_from_world * turn;
        for (uint64_t i = 1; i <= 50; ++i) {
          image.points2D.push_back(
              {Vector3d((cam_from_world * turn) * object.points3D[i].xyz).hnormalized(), i});
          object.points3D[i].track.push_back({id, static_cast<uint32_t>(i - 1)});
        }
        object.images[id] = image;
        image.cam_from_world = cam_from_world;
        for (uint64_t i = 1; i <= 50; ++i) {
          image.points2D[i - 1].xy = Vector3d(cam_from_world * background.points3D[i].xyz).hnormalized();
          background.points3D[i].track.push_back({id, static_cast<uint32_t>(i - 1)});
        }
        background.images[id] = image;
      }
    }
    TransformModel(object_frame, &object);
    TransformModel(background_frame, &background);
  }
};

// Every observation still fits: the models were moved as one.
double ReprojectionError(const ColmapModel& model) {
  double worst = 0;
  for (const auto& [id, point] : model.points3D) {
    for (const ColmapTrackElement& element : point.track) {
      const ColmapImage& image = model.images.at(element.image_id);
      const ColmapPoint2D& seen = image.points2D.at(element.point2D_idx);
      EXPECT_EQ(seen.point3D_id, id);
      worst = std::max(worst, (Vector3d(image.cam_from_world * point.xyz).hnormalized() - seen.xy).norm());
    }
  }
  return worst;
}

void ExpectConventions(const AlignedScene& aligned) {
  const TurntableScene& scene = aligned.scene;
  EXPECT_EQ(scene.axis.direction, Vector3d::UnitZ());
  EXPECT_EQ(scene.axis.point, Vector3d::Zero());
  ASSERT_FALSE(scene.views.empty());
  EXPECT_EQ(scene.views[0].angle_deg, 0);
  EXPECT_LT((scene.views[0].world_from_object.Matrix() - Eigen::Matrix4d::Identity()).norm(), 1e-12);
  for (const auto& [id, image] : aligned.object.images) {
    const auto view = std::find_if(scene.views.begin(), scene.views.end(),
                                   [&, n = image.name](const View& v) { return v.name == n; });
    ASSERT_NE(view, scene.views.end());
    const Eigen::Matrix4d product = view->cam_from_world.Matrix() * view->world_from_object.Matrix();
    EXPECT_LT((product - image.cam_from_world.Matrix()).cwiseAbs().maxCoeff(), 1e-9);
    EXPECT_GT(CameraCentre(view->cam_from_world).z(), 0);  // looks from above
  }
}

TEST(AlignScene, ExactModelsMeetInTheConventions) {
  for (uint32_t seed = 0; seed < 5; ++seed) {
    Models models;
    models.Build(seed);
    for (const CameraPoseSource source : {CameraPoseSource::kSharedStations, CameraPoseSource::kPerImage}) {
      AlignOptions options;
      options.pose_source = source;
      const AlignedScene aligned =
          AlignScene(models.object, &models.background, models.station_of_image, options);
      ExpectConventions(aligned);
      EXPECT_EQ(aligned.scene.views.size(), 27u);
      EXPECT_TRUE(aligned.left_out.empty());
      EXPECT_TRUE(aligned.scene.scale_observable);
      EXPECT_EQ(aligned.scene.num_stations, 3);
      EXPECT_LT(ReprojectionError(aligned.object), 1e-9);
      EXPECT_LT(ReprojectionError(aligned.background), 1e-9);
      EXPECT_NEAR(aligned.aligned_from_object.scale, 1, 1e-12);
      EXPECT_NEAR(aligned.aligned_from_background.scale * models.scale, 1, 1e-9);
      // The mean object point is at height 0, up to trimming: heights scatter by 0.1.
      double sum = 0;
      for (const auto& [id, point] : aligned.object.points3D) sum += point.xyz.z();
      EXPECT_NEAR(sum / 50, 0, 0.01);
      const Vector3d reference = CameraCentre(aligned.scene.views[0].cam_from_world);
      EXPECT_NEAR(reference.y(), 0, 1e-9);
      EXPECT_GT(reference.x(), 0);
    }
  }
}

TEST(AlignScene, StationsThatOnlyHaveARepresentativeShareItsPose) {
  Models models;
  models.Build(7);
  std::vector<std::string> rest;
  for (const auto& [id, image] : models.background.images) {
    if (image.name.find("_000") == std::string::npos) rest.push_back(image.name);
  }
  RemoveImages(rest, &models.background);
  EXPECT_EQ(models.background.images.size(), 3u);
  const AlignedScene aligned = AlignScene(models.object, &models.background, models.station_of_image);
  ExpectConventions(aligned);
  EXPECT_EQ(aligned.scene.views.size(), 27u);
  EXPECT_EQ(aligned.background.images.size(), 3u);
  EXPECT_LT(ReprojectionError(aligned.object), 1e-9);
  EXPECT_LT(ReprojectionError(aligned.background), 1e-9);
}

TEST(AlignScene, WrongPosesAreLeftOutOfBothModelsAndTracks) {
  Models models;
  models.Build(8);
  models.object.images[5].cam_from_world.rotation = Eigen::Quaterniond(0.5, 0.5, 0.5, -0.5);
  const AlignedScene aligned = AlignScene(models.object, &models.background, models.station_of_image);
  ASSERT_EQ(aligned.left_out, std::vector<std::string>{models.object.images[5].name});
  EXPECT_EQ(aligned.object.images.count(5), 0u);
  EXPECT_EQ(aligned.background.images.count(5), 0u);
  EXPECT_EQ(aligned.object.points3D.at(1).track.size(), 26u);
  ExpectConventions(aligned);
  EXPECT_LT(ReprojectionError(aligned.object), 1e-9);
}

TEST(AlignScene, WithoutABackgroundTheObjectPlacesTheStations) {
  for (const int stations : {1, 3}) {
    Models models;
    models.stations = stations;
    models.Build(9);
    const AlignedScene aligned = AlignScene(models.object, nullptr, models.station_of_image);
    ExpectConventions(aligned);
    EXPECT_EQ(aligned.scene.views.size(), static_cast<size_t>(9 * stations));
    EXPECT_FALSE(aligned.scene.scale_observable);
    EXPECT_EQ(aligned.scene.num_stations, stations);
    EXPECT_TRUE(aligned.background.images.empty());
    EXPECT_LT(ReprojectionError(aligned.object), 1e-9);
    for (const View& view : aligned.scene.views) {
      const double expected = std::stoi(view.name.substr(3, 3)) * 23.0;
      EXPECT_NEAR(std::remainder(view.angle_deg - expected, 360), 0, 1e-7) << view.name;
    }
  }
}

TEST(AlignScene, ObjectTurnedOverKeepsOneTable) {
  Models models;
  models.steps = 16;
  models.Build(10);
  const Rigid3 flip{Eigen::Quaterniond(Eigen::AngleAxisd(3.0, Vector3d(1, 0.5, 0.2).normalized())),
                    Vector3d(0.1, 0, 0.2)};
  for (auto& [id, image] : models.object.images) {
    if (image.name.substr(3, 3) >= "010") image.cam_from_world = image.cam_from_world * flip;
  }
  const AlignedScene aligned = AlignScene(models.object, &models.background, models.station_of_image);
  EXPECT_EQ(aligned.solution.groups.size(), 2u);
  ExpectConventions(aligned);
  EXPECT_EQ(aligned.scene.views.size(), 48u);
  // Poses are those of the input, moved: cam_from_object of both groups.
  for (const auto& [id, image] : aligned.object.images) {
    const Rigid3 expected{
        (models.object.images[id].cam_from_world.rotation * aligned.aligned_from_object.rotation.conjugate())
            .normalized(),
        Vector3d::Zero()};
    EXPECT_LT(AngleBetween(expected.rotation, image.cam_from_world.rotation), 1e-8);
    EXPECT_LT((CameraCentre(image.cam_from_world) -
               aligned.aligned_from_object * CameraCentre(models.object.images[id].cam_from_world))
                  .norm(),
              1e-8);
  }
}

// An object that was pushed aside turns about the same direction as before: angles do not tell where it lies.
TEST(AlignScene, JointProblemOfAnObjectThatWasPushedAside) {
  Models models;
  models.Build(13);
  AlignedScene aligned = AlignScene(models.object, &models.background, models.station_of_image);
  const Vector3d aside(0.1, 0.2, 0);
  for (size_t i = aligned.scene.views.size() / 2; i < aligned.scene.views.size(); ++i)
    aligned.scene.views[i].world_from_object.translation += aside;
  const JointProblem problem = MakeJointProblem(aligned);
  EXPECT_TRUE(problem.free_object);
  for (size_t i = 0; i < aligned.scene.views.size(); ++i) {
    EXPECT_EQ(problem.WorldFromObject(static_cast<int>(i)).translation,
              aligned.scene.views[i].world_from_object.translation);
  }
}

// Into the joint adjustment's form and back: nothing moves, and conventions hold again after it moved.
TEST(AlignScene, JointProblemAndBack) {
  Models models;
  models.Build(13);
  for (const CameraPoseSource source : {CameraPoseSource::kSharedStations, CameraPoseSource::kPerImage}) {
    AlignOptions options;
    options.pose_source = source;
    AlignedScene aligned = AlignScene(models.object, &models.background, models.station_of_image, options);
    const AlignedScene before = aligned;
    JointProblem problem = MakeJointProblem(aligned);
    EXPECT_FALSE(problem.free_object);
    EXPECT_EQ(problem.object.observations.size(), 27u * 50);
    ApplyJointProblem(problem, &aligned);
    for (size_t i = 0; i < before.scene.views.size(); ++i) {
      EXPECT_LT(
          (before.scene.views[i].cam_from_world.Matrix() - aligned.scene.views[i].cam_from_world.Matrix())
              .cwiseAbs()
              .maxCoeff(),
          1e-12);
      EXPECT_NEAR(before.scene.views[i].angle_deg, aligned.scene.views[i].angle_deg, 1e-12);
    }
    EXPECT_LT(ReprojectionError(aligned.object), 1e-9);

    // The whole problem moved: the conventions bring it back.
    problem = MakeJointProblem(aligned);
    const Rigid3 move{Eigen::Quaterniond(ExpRotation<double>(Vector3d(0.05, -0.1, 0.7))),
                      Vector3d(0.3, 0.2, -0.4)};
    for (Rigid3& pose : problem.cam_from_world) pose = pose * move.Inverse();
    const Vector3d direction = move.rotation * Vector3d::UnitZ();
    const Vector3d point = move.translation - direction * (move.translation.z() / direction.z());
    problem.axis << direction.x() / direction.z(), direction.y() / direction.z(), point.x(), point.y();
    for (JointBody* body : {&problem.object, &problem.background}) {
      for (Vector3d& x : body->points) x = move * x;
    }
    problem.object.observations[3].active = false;  // point 1 at image 4
    ApplyJointProblem(problem, &aligned);
    ExpectConventions(aligned);
    EXPECT_LT(ReprojectionError(aligned.object), 1e-9);
    EXPECT_LT(ReprojectionError(aligned.background), 1e-9);
    EXPECT_EQ(aligned.object.points3D.at(1).track.size(), 26u);
    for (size_t i = 0; i < before.scene.views.size(); ++i) {
      EXPECT_LT(
          (before.scene.views[i].cam_from_world.Matrix() - aligned.scene.views[i].cam_from_world.Matrix())
              .cwiseAbs()
              .maxCoeff(),
          1e-9);
    }
  }
}

TEST(AlignScene, NothingRotatingLeavesTheSceneEmpty) {
  Models models;
  models.step_deg = 0;
  models.Build(11);
  const AlignedScene aligned = AlignScene(models.object, &models.background, models.station_of_image);
  EXPECT_EQ(aligned.solution.motion, TurntableMotion::kNothingRotates);
  EXPECT_TRUE(aligned.scene.views.empty());
}

TEST(AlignScene, ModelsWithoutACommonImageLeaveTheSceneEmpty) {
  Models models;
  models.Build(12);
  for (auto& [id, image] : models.background.images) image.name = "other/" + image.name;
  const AlignedScene aligned = AlignScene(models.object, &models.background, models.station_of_image);
  EXPECT_EQ(aligned.solution.motion, TurntableMotion::kTooFewImages);
  EXPECT_TRUE(aligned.scene.views.empty());
}

}  // namespace
}  // namespace s2gs
