#include "s2gs/turn_evidence.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <vector>

#include "sfm_split/base/angles.h"
#include "tests/s2gs/backend/reference_render.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

constexpr int kSize = 80;       // [px]
constexpr double kFocal = 80;   // [px]
constexpr double kHeight = 4;   // of the camera above the table: a unit of length is 20 px.
constexpr double kCard = 0.35;  // half the side of a card that turns about the axis,
constexpr double kArm = 1;      // at this distance from it.

enum class Ground : uint8_t { kTextured, kPlain };

// A smooth random field about 0 with details of some pixels.
class Texture {
 public:
  explicit Texture(uint64_t seed) {
    RandomNumbers random(seed);
    for (int i = 0; i < 24; ++i) {
      waves_.push_back({14 * random.Normal(), 14 * random.Normal(), 2 * kPi * random.Uniform()});
    }
  }
  double At(double x, double y) const {
    double sum = 0;
    for (const Eigen::Vector3d& wave : waves_) sum += std::cos(wave.x() * x + wave.y() * y + wave.z());
    return sum / std::sqrt(12.0);
  }

 private:
  std::vector<Eigen::Vector3d> waves_;
};

// The card at angle 0 lies about (kArm, 0).
bool IsOnCard(double x, double y) { return std::abs(x - kArm) < kCard && std::abs(y) < kCard; }

// One camera above a ground, before which a card goes round in `num_photos` steps.
// \param camera_step  how far the camera goes on for each photo.
// \param camera_turn  by how much it looks aside in every other photo [rad].
TrainingScene CardOnGround(Ground ground, int num_photos, double camera_step = 0, double camera_turn = 0) {
  const Texture ground_texture(1);
  const Texture card_texture(2);
  RandomNumbers random(3);
  TrainingScene scene;
  scene.mode = TrainMode::kS2gs;
  scene.axis = TurntableAxis();
  scene.region = RotatingRegion{TurntableAxis(), 2, -0.5, 0.5};
  for (int i = 0; i < num_photos; ++i) {
    ScenePhoto photo;
    PinholeView& view = photo.view;
    view.width = view.height = kSize;
    view.fx = view.fy = kFocal;
    view.cx = view.cy = kSize / 2.0;
    view.cam_from_world = {Eigen::Quaterniond(Eigen::AngleAxisd(kPi, Eigen::Vector3d::UnitX())),
                           {camera_step * i, 0, kHeight}};
    const Eigen::Quaterniond aside(Eigen::AngleAxisd(i % 2 * camera_turn, Eigen::Vector3d::UnitY()));
    view.cam_from_world = Rigid3{aside, Eigen::Vector3d::Zero()} * view.cam_from_world;
    const Rigid3 world_from_cam = view.cam_from_world.Inverse();
    const Eigen::AngleAxisd turn(2 * kPi * i / num_photos, Eigen::Vector3d::UnitZ());
    const Rigid3 world_from_object{Eigen::Quaterniond(turn), Eigen::Vector3d::Zero()};
    view.cam_from_object = view.cam_from_world * world_from_object;
    photo.image = {kSize, kSize, 3, {}};
    for (int row = 0; row < kSize; ++row) {
      for (int column = 0; column < kSize; ++column) {
        const Eigen::Vector3d ray =
            world_from_cam.rotation *
            Eigen::Vector3d((column + 0.5 - view.cx) / view.fx, (row + 0.5 - view.cy) / view.fy, 1);
        const Eigen::Vector3d on_ground =
            world_from_cam.translation - world_from_cam.translation.z() / ray.z() * ray;
        const double x = on_ground.x();
        const double y = on_ground.y();
        const Eigen::Vector3d on_object = world_from_object.Inverse() * Eigen::Vector3d(x, y, 0);
        const bool is_card = IsOnCard(on_object.x(), on_object.y());
        double grey = 110;
        if (is_card) grey += 30 + 25 * card_texture.At(on_object.x(), on_object.y());
        if (!is_card && ground == Ground::kTextured) grey += 12 * ground_texture.At(x, y);
        for (int c = 0; c < 3; ++c) {
          photo.image.pixels.push_back(
              static_cast<uint8_t>(std::clamp(std::lround(grey + random.Normal()), 0L, 255L)));
        }
      }
    }
    scene.photos.push_back(std::move(photo));
  }
  return scene;
}

ReferenceGaussian Splat(double x, double y, bool rotates) {
  ReferenceGaussian g{};
  g[kRefCentre] = x;
  g[kRefCentre + 1] = y;
  g[kRefLogScale] = g[kRefLogScale + 1] = std::log(0.03);
  g[kRefRotation] = 1;
  g[kRefOpacity] = 4;
  g[kRefForeground] = rotates ? 10 : -10;
  return g;
}

// Which of the splats of a model in which the card, and the ground about it as far as a quarter of a unit,
// rotate, are said to stand.
struct Judged {
  int num_card = 0, num_card_standing = 0;      // on the card.
  int num_ground = 0, num_ground_standing = 0;  // more than 4 px beside it.
  int num_others = 0;                           // static ones that are named.
};

Judged Judge(const TrainingScene& scene) {
  std::vector<ReferenceGaussian> splats;
  constexpr double kReach = kCard + 0.45;
  for (double x = -kReach; x <= kReach; x += 0.05) {
    for (double y = -kReach; y <= kReach; y += 0.05) splats.push_back(Splat(kArm + x, y, true));
  }
  splats.push_back(Splat(-1, -1, false));
  const std::unique_ptr<Backend> backend = MakeCpuBackend(1);
  TrainState state;
  state.gaussians = FromReference(splats, 0);
  backend->SetState(state);
  const std::vector<uint32_t> standing = FindStandingGaussians(TurnEvidence(scene), backend.get());
  EXPECT_EQ(backend->GetGaussians().centre, state.gaussians.centre);
  EXPECT_EQ(backend->GetGaussians().foreground_logit, state.gaussians.foreground_logit);
  std::vector<bool> is_standing(splats.size(), false);
  for (const uint32_t i : standing) is_standing[i] = true;
  Judged judged;
  for (size_t i = 0; i < splats.size(); ++i) {
    const double beside =
        std::max(std::abs(splats[i][kRefCentre] - kArm), std::abs(splats[i][kRefCentre + 1])) - kCard;
    const int is_named = is_standing[i] ? 1 : 0;
    if (splats[i][kRefForeground] < 0) {
      judged.num_others += is_named;
    } else if (beside < 0) {
      ++judged.num_card;
      judged.num_card_standing += is_named;
    } else if (beside > 0.2) {
      ++judged.num_ground;
      judged.num_ground_standing += is_named;
    }
  }
  return judged;
}

TEST(TurnEvidence, GroundThatIsSeenThroughDoesNotTurn) {
  const Judged judged = Judge(CardOnGround(Ground::kTextured, 24));
  EXPECT_EQ(judged.num_card_standing, 0) << "of " << judged.num_card;
  // All 540 measured.
  EXPECT_EQ(judged.num_ground, 540);
  EXPECT_GE(judged.num_ground_standing, 535);
  EXPECT_EQ(judged.num_others, 0);
}

// A tripod that is touched: every other photo lies 4 px aside.
TEST(TurnEvidence, ACameraThatTurnsTellsTheSame) {
  const Judged judged = Judge(CardOnGround(Ground::kTextured, 24, 0, 0.05));
  EXPECT_EQ(judged.num_card_standing, 0) << "of " << judged.num_card;
  EXPECT_GE(judged.num_ground_standing, 535) << "of " << judged.num_ground;
  EXPECT_EQ(judged.num_others, 0);
}

TEST(TurnEvidence, APlainGroundTellsNothing) {
  const Judged judged = Judge(CardOnGround(Ground::kPlain, 24));
  EXPECT_EQ(judged.num_card_standing, 0);
  EXPECT_EQ(judged.num_ground_standing, 0) << "of " << judged.num_ground;
}

TEST(TurnEvidence, NeedsACameraThatStandsStill) {
  EXPECT_TRUE(TurnEvidence(CardOnGround(Ground::kTextured, 10)).IsAvailable());
  EXPECT_FALSE(TurnEvidence(CardOnGround(Ground::kTextured, 9)).IsAvailable());
  // A pixel from photo to photo.
  EXPECT_FALSE(TurnEvidence(CardOnGround(Ground::kTextured, 24, 0.05)).IsAvailable());
  TrainingScene held_out = CardOnGround(Ground::kTextured, 10);
  held_out.photos[0].held_out = true;
  EXPECT_FALSE(TurnEvidence(held_out).IsAvailable());
}

TEST(TurnEvidence, SeesTheCardTheGroundAndWhatIsNeverFree) {
  const TrainingScene scene = CardOnGround(Ground::kTextured, 24);
  const TurnEvidence evidence(scene);
  ASSERT_EQ(evidence.views().size(), 24U);
  // Said to be covered: in each photo where the card is, and everywhere the middle.
  std::vector<std::vector<uint8_t>> covered;
  for (const PinholeView& view : evidence.views()) {
    std::vector<uint8_t> inside;
    for (int row = 0; row < kSize; ++row) {
      for (int column = 0; column < kSize; ++column) {
        const Eigen::Vector3d x((column + 0.5 - view.cx) * kHeight / kFocal,
                                -(row + 0.5 - view.cy) * kHeight / kFocal, 0);
        const Eigen::Vector3d on_object = view.cam_from_object.Inverse() * (view.cam_from_world * x);
        inside.push_back(IsOnCard(on_object.x(), on_object.y()) || x.norm() < 0.3 ? 1 : 0);
      }
    }
    covered.push_back(std::move(inside));
  }
  const std::vector<std::vector<PixelSight>> sights = evidence.Look(covered);
  int on_card = 0;
  int other_on_card = 0;
  int on_ground = 0;
  int background_on_ground = 0;
  for (int row = 4; row < kSize - 4; ++row) {
    for (int column = 4; column < kSize - 4; ++column) {
      const double x = (column + 0.5 - kSize / 2.0) / 20;
      const double y = -(row + 0.5 - kSize / 2.0) / 20;
      const PixelSight sight = sights[0][static_cast<size_t>(row) * kSize + column];
      if (std::hypot(x, y) < 0.25) {
        EXPECT_EQ(sight, PixelSight::kNeverFree);
      } else if (IsOnCard(x, y)) {
        ++on_card;
        other_on_card += sight == PixelSight::kOther ? 1 : 0;
        EXPECT_NE(sight, PixelSight::kBackground);
      } else if (std::max(std::abs(x - kArm), std::abs(y)) > kCard + 0.2 && std::hypot(x, y) > 0.5) {
        ++on_ground;
        background_on_ground += sight == PixelSight::kBackground ? 1 : 0;
        EXPECT_NE(sight, PixelSight::kOther);
      }
    }
  }
  // 71 % of 196 pixels measured: the others have nearly the ground's own grey level.
  EXPECT_EQ(on_card, 196);
  EXPECT_NEAR(other_on_card, 139, 6);
  EXPECT_GE(background_on_ground, on_ground - 10);  // all 4,390 measured.
}

// A model of the card alone, and one in which the ground about it turns along.
TEST(TurnEvidence, MeasuresWhatPhotosTell) {
  const auto measure = [](Ground ground, double reach) {
    std::vector<ReferenceGaussian> splats;
    for (double x = -reach; x <= reach; x += 0.05) {
      for (double y = -reach; y <= reach; y += 0.05) splats.push_back(Splat(kArm + x, y, true));
    }
    const std::unique_ptr<Backend> backend = MakeCpuBackend(1);
    TrainState state;
    state.gaussians = FromReference(splats, 0);
    backend->SetState(state);
    return MeasureSights(TurnEvidence(CardOnGround(ground, 24)), backend.get());
  };
  const std::optional<SightShares> card = measure(Ground::kTextured, kCard);
  const std::optional<SightShares> wide = measure(Ground::kTextured, 2 * kCard);
  const std::optional<SightShares> plain = measure(Ground::kPlain, 2 * kCard);
  ASSERT_TRUE(card && wide && plain);
  EXPECT_EQ(card->num_cameras, 1);
  EXPECT_EQ(card->num_photos, 24);
  for (const SightShares& shares : {*card, *wide, *plain}) {
    EXPECT_NEAR(shares.other + shares.background + shares.alike + shares.never_free, 1, 1e-12);
    EXPECT_EQ(shares.never_free, 0);
  }
  // Three quarters of the wide square are ground, less what is within some pixels of the card or of its grey
  // level.
  // Measured; another rounding moves single pixels, a thousandth of the shares.
  EXPECT_NEAR(card->other, 0.569, 0.006);
  EXPECT_NEAR(card->background, 0.032, 0.006);
  EXPECT_NEAR(wide->other, 0.171, 0.006);
  EXPECT_NEAR(wide->background, 0.619, 0.006);
  EXPECT_NEAR(plain->other, 0.190, 0.006);
  EXPECT_LT(card->background, 0.05);
  EXPECT_GT(card->other, 0.5);
  EXPECT_GT(wide->background, 0.4);
  EXPECT_EQ(plain->background, 0);
  EXPECT_GT(plain->alike, 0.6);
  const TurnEvidence nothing(CardOnGround(Ground::kTextured, 9));
  const std::unique_ptr<Backend> backend = MakeCpuBackend(1);
  const std::optional<SightShares> unavailable = MeasureSights(nothing, backend.get());
  ASSERT_TRUE(unavailable);
  EXPECT_EQ(unavailable->num_cameras, 0);
}

// What lies about the axis hides the same ground in every photo: nothing shows what stands behind it.
TEST(TurnEvidence, TheMiddleIsNeverFree) {
  std::vector<ReferenceGaussian> splats;
  constexpr double kReach = 0.3;
  for (double x = -kReach; x <= kReach; x += 0.05) {
    for (double y = -kReach; y <= kReach; y += 0.05) splats.push_back(Splat(x, y, true));
  }
  const std::unique_ptr<Backend> backend = MakeCpuBackend(1);
  TrainState state;
  state.gaussians = FromReference(splats, 0);
  backend->SetState(state);
  const std::optional<SightShares> shares =
      MeasureSights(TurnEvidence(CardOnGround(Ground::kTextured, 24)), backend.get());
  ASSERT_TRUE(shares);
  // A square of 12 px that turns covers a circle of 6 px always, and with the border's 2 px one of 8 px; the
  // corners reach 8.5 px.
  EXPECT_GT(shares->never_free, 0.95);
}

TEST(TurnEvidence, SignTestPassesByChanceOnceInAThousand) {
  // The binomial tail at one half: the larger share of n photos or more.
  const auto tail = [](int background, int n) {
    double sum = 0;
    for (int k = background; k <= n; ++k) {
      sum += std::exp(std::lgamma(n + 1.0) - std::lgamma(k + 1.0) - std::lgamma(n - k + 1.0) -
                      n * std::log(2.0));
    }
    return sum;
  };
  for (int n = 0; n <= 60; ++n) {
    for (int background = 0; background <= n; ++background) {
      const bool is_standing = SightVotes{n - background, background}.IsStanding();
      const double chance = tail(background, n);
      // The normal law for the binomial one: off by less than a factor of two and a half at these counts.
      EXPECT_FALSE(is_standing && chance > 2e-3) << background << " of " << n;
      EXPECT_FALSE(!is_standing && chance < 4e-4) << background << " of " << n;
    }
  }
}

}  // namespace
}  // namespace s2gs
