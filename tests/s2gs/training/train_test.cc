#include "s2gs/training/train.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <string_view>

#include "s2gs/checkpoint.h"
#include "s2gs/freeze.h"
#include "s2gs/initialise.h"
#include "s2gs/kernel/foreground.h"
#include "tests/s2gs/expect_gaussians.h"
#include "tests/s2gs/small_scene.h"
#include "tests/support/measured_bound.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

TrainOptions QuickOptions(int64_t iterations) {
  TrainOptions options;
  options.num_iterations = iterations;
  options.initial.min_points = 600;
  options.growth = GrowthStrategy::kBudget;
  options.max_gaussians = 2000;
  options.densify_every = 20;
  options.min_coarse_size = 32;
  options.num_measurements = 3;
  return options;
}

// Asks to stop when training has made this many reports.
class StoppingReporter : public Reporter {
 public:
  explicit StoppingReporter(int64_t at) : at_(at) {}
  void Progress(std::string_view task, int64_t done, int64_t /*total*/) override {
    if (task == "train" && done >= at_) stop_ = true;
  }
  bool StopRequested() const override { return stop_; }

 private:
  int64_t at_;
  bool stop_ = false;
};

// What training says, line by line.
class Listener : public Reporter {
 public:
  void Log(LogLevel level, std::string_view message) override {
    (level == LogLevel::kWarning ? warnings : infos) += std::string(message) + "\n";
  }
  std::string infos;
  std::string warnings;
};

std::vector<nlohmann::json> LinesOf(const std::string& log, const char* event) {
  std::vector<nlohmann::json> lines;
  std::istringstream stream(log);
  std::string line;
  while (std::getline(stream, line)) {
    const nlohmann::json value = nlohmann::json::parse(line);
    if (value["event"] == event) lines.push_back(value);
  }
  return lines;
}

TEST(Train, TellsTheBodiesApartAndExplainsPhotosNeverSeen) {
  const TrainingScene scene = MakeSmallScene(TrainMode::kS2gs, 80, 60, 2, 12);
  Reporter silent;
  const auto backend = MakeCpuBackend(1);
  const TrainOptions options = QuickOptions(600);
  const TrainResult result = Train(scene, options, 1, {}, backend.get(), silent);
  ASSERT_TRUE(result.held_out.has_value());
  // Measured: tests/bench/notes/training.md; the bounds leave room for another compiler's rounding.
  EXPECT_GT(result.held_out->psnr, 20);
  EXPECT_GT(result.held_out->mask_iou, 0.78);
  EXPECT_GT(SettledShare(result.gaussians.foreground_logit), 0.99);
  EXPECT_TRUE(result.foreground_frozen);
  RecordProperty("psnr", std::to_string(result.held_out->psnr));
  RecordProperty("mask_iou", std::to_string(result.held_out->mask_iou));
}

// Two rounds of three through the photos show the tiles of the rotating part alone.
TEST(Train, WholeFramesNowAndThenAreEnoughForTheRotatingPart) {
  const TrainingScene scene = MakeSmallScene(TrainMode::kS2gs, 80, 60, 2, 12);
  Reporter silent;
  TrainOptions options = QuickOptions(600);
  const TrainResult always = Train(scene, options, 1, {}, MakeCpuBackend(1).get(), silent);
  options.whole_every = 3;
  const TemporaryFolder folder;
  TrainFiles files;
  files.log = folder / "log.jsonl";
  const TrainResult sometimes = Train(scene, options, 1, files, MakeCpuBackend(1).get(), silent);
  ASSERT_TRUE(sometimes.held_out.has_value());
  EXPECT_NE(sometimes.gaussians.centre, always.gaussians.centre);
  // Measured: .01 dB better; two seeds differ by .1 dB.
  EXPECT_GT(sometimes.held_out->object_psnr, always.held_out->object_psnr - 0.2);
  EXPECT_GT(sometimes.held_out->mask_iou, 0.78);
  // Losses of both kinds have lines of their own: from the first on that draws a part, two of three
  // iterations.
  double all = 0;
  double part = 0;
  double last = 0;
  for (const nlohmann::json& line : LinesOf(folder.Read("log.jsonl"), "loss")) {
    const double span = line["iteration"].get<double>() - last;
    EXPECT_GT(span, 0);
    last += span;
    if (!line["whole"].get<bool>()) part += span;
    if (part > 0) all += span;
  }
  EXPECT_EQ(last, 600);
  EXPECT_GT(all, 100);
  EXPECT_NEAR(part / all, 2 / 3.0, 2 * 11 / all);  // the course begins and ends within a round of 11 photos
}

TEST(Train, WarnsWhereTheRotatingPartHasNoPoints) {
  class Warnings : public Reporter {
   public:
    void Log(LogLevel level, std::string_view message) override {
      if (level == LogLevel::kWarning) text += message;
    }
    std::string text;
  };
  TrainingScene scene = MakeSmallScene(TrainMode::kS2gs, 32, 24, 2, 4);
  Warnings warnings;
  const size_t some = InitialiseGaussians(scene, {}, 1, warnings).size();
  EXPECT_EQ(warnings.text, "");
  scene.points.erase(std::remove_if(scene.points.begin(), scene.points.end(),
                                    [](const ScenePoint& point) { return point.rotates; }),
                     scene.points.end());
  EXPECT_EQ(InitialiseGaussians(scene, {}, 1, warnings).size(), some);  // filled up with random ones
  EXPECT_THAT(warnings.text, testing::HasSubstr("has no points"));
}

TEST(Train, KeepsItsGaussiansThroughOpacityResets) {
  const TrainingScene scene = MakeSmallScene(TrainMode::kS2gs, 64, 48, 2, 10);
  TrainOptions options = QuickOptions(300);
  options.densify_every = 10;
  options.opacity_reset_every = 0.1;
  Reporter silent;
  const TrainResult result = Train(scene, options, 1, {}, MakeCpuBackend().get(), silent);
  EXPECT_GT(result.gaussians.size(), 1000U);
  ASSERT_TRUE(result.held_out.has_value());
  EXPECT_GT(result.held_out->psnr, 15);
}

TEST(Train, IsBitIdenticalForAnyNumberOfThreads) {
  const TrainingScene scene = MakeSmallScene(TrainMode::kS2gs, 64, 48, 2, 6);
  Reporter silent;
  TrainOptions options = QuickOptions(120);
  options.whole_every = 3;
  options.normal_from = 0.3;
  options.distortion_weight = 10;
  const Gaussians one = Train(scene, options, 3, {}, MakeCpuBackend(1).get(), silent).gaussians;
  const Gaussians two = Train(scene, options, 3, {}, MakeCpuBackend(2).get(), silent).gaussians;
  const Gaussians five = Train(scene, options, 3, {}, MakeCpuBackend(5).get(), silent).gaussians;
  ExpectSameGaussians(one, two);
  ExpectSameGaussians(one, five);
  ExpectWithin(numerics::kRepeatability, "training with 1, 2 and 5 threads: runs that differ in any bit",
               "cpu",
               (one.centre == two.centre && one.sh_rest == two.sh_rest ? 0 : 1) +
                   (one.centre == five.centre && one.sh_rest == five.sh_rest ? 0 : 1),
               0);
  const Gaussians other = Train(scene, options, 4, {}, MakeCpuBackend(2).get(), silent).gaussians;
  EXPECT_NE(one.centre, other.centre) << "the seed has no influence";
}

TEST(Train, ResumesAsIfItHadNeverStopped) {
  const TrainingScene scene = MakeSmallScene(TrainMode::kS2gs, 64, 48, 2, 6);
  const TrainOptions options = QuickOptions(120);
  Reporter silent;
  const Gaussians straight = Train(scene, options, 3, {}, MakeCpuBackend().get(), silent).gaussians;

  const TemporaryFolder folder;
  TrainFiles files;
  files.checkpoint = folder / "latest.checkpoint";
  files.log = folder / "log.jsonl";
  files.settings = "same";
  for (const int64_t stop_at : {20, 50, 77, 100}) {
    StoppingReporter stopping(stop_at);
    EXPECT_THROW(Train(scene, options, 3, files, MakeCpuBackend().get(), stopping), Interrupted);
    EXPECT_EQ(ReadCheckpoint(files.checkpoint).cursor.iteration, stop_at);
  }
  Listener listener;
  ExpectSameGaussians(Train(scene, options, 3, files, MakeCpuBackend().get(), listener).gaussians, straight);
  EXPECT_THAT(listener.infos, testing::HasSubstr("going on after iteration 100 from"));
  EXPECT_EQ(listener.warnings, "");

  // One line per report, each iteration once.
  std::istringstream lines(folder.Read("log.jsonl"));
  std::string line;
  int64_t last = 0;
  while (std::getline(lines, line)) {
    const nlohmann::json value = nlohmann::json::parse(line);
    if (value["event"] != "loss") continue;
    EXPECT_GT(value["iteration"].get<int64_t>(), last);
    last = value["iteration"].get<int64_t>();
  }
  EXPECT_EQ(last, 120);
}

TEST(Train, BeginsAnewBesideACheckpointWhenToldSo) {
  const TrainingScene scene = MakeSmallScene(TrainMode::kS2gs, 64, 48, 2, 6);
  const TemporaryFolder folder;
  TrainFiles files;
  files.checkpoint = folder / "latest.checkpoint";
  files.settings = "same";
  for (const int64_t stop_at : {30, 10}) {
    StoppingReporter stopping(stop_at);
    EXPECT_THROW(Train(scene, QuickOptions(120), 3, files, MakeCpuBackend().get(), stopping), Interrupted);
    EXPECT_EQ(ReadCheckpoint(files.checkpoint).cursor.iteration, stop_at);
    files.resume = false;
  }
}

// An error that can be anything at the end is not to be had: with a threshold of all of it, training stops as
// soon as there are enough measurements.
TEST(Train, StopsWhenHeldOutPhotosGainTooLittleAlsoWhenResumed) {
  const TrainingScene scene = MakeSmallScene(TrainMode::kS2gs, 48, 36, 2, 10);
  TrainOptions options = QuickOptions(200);
  options.stop_gain_pct = 100;
  Reporter silent;
  const TemporaryFolder folder;
  TrainFiles files;
  files.log = folder / "log.jsonl";
  const TrainResult stopped = Train(scene, options, 3, files, MakeCpuBackend().get(), silent);
  EXPECT_LT(stopped.iterations, 180);
  EXPECT_GT(stopped.iterations, 140);  // .6 of the run for the model to settle, then three intervals
  EXPECT_NE(folder.Read("log.jsonl").find("\"part\":\"end_of_training\",\"left_out\":true"),
            std::string::npos);

  files.checkpoint = folder / "latest.checkpoint";
  for (const int64_t stop_at : {100, 134}) {
    StoppingReporter stopping(stop_at);
    EXPECT_THROW(Train(scene, options, 3, files, MakeCpuBackend().get(), stopping), Interrupted);
  }
  const TrainResult resumed = Train(scene, options, 3, files, MakeCpuBackend().get(), silent);
  EXPECT_EQ(resumed.iterations, stopped.iterations);
  ExpectSameGaussians(resumed.gaussians, stopped.gaussians);

  options.stop_gain_pct = 0;
  EXPECT_EQ(Train(scene, options, 3, {}, MakeCpuBackend().get(), silent).iterations, 200);
  // Few photos held out never stop it.
  TrainingScene few = scene;
  int kept = HeldOutCourse::kMinPhotos - 1;
  for (ScenePhoto& photo : few.photos) photo.held_out = photo.held_out && kept-- > 0;
  options.stop_gain_pct = 100;
  EXPECT_EQ(Train(few, options, 3, {}, MakeCpuBackend().get(), silent).iterations, 200);
}

// Sixteen photos a station, of which every fifth is held out: enough to see what stands behind the rotating
// part, also for a run that goes on after p was frozen.
TEST(Train, MeasuresWhatPhotosTellAlsoWhenResumed) {
  TrainingScene scene = MakeSmallScene(TrainMode::kS2gs, 48, 36, 2, 16);
  RotatingRegion region{*scene.axis, 0, 1e9, -1e9};
  for (const ScenePoint& point : scene.points) {
    if (!point.rotates) continue;
    const double height = (point.x - region.axis.point).dot(region.axis.direction);
    region.low = std::min(region.low, height);
    region.high = std::max(region.high, height);
    region.radius =
        std::max(region.radius, (point.x - region.axis.point - height * region.axis.direction).norm());
  }
  scene.region = region;
  const TrainOptions options = QuickOptions(60);
  const TemporaryFolder folder;
  TrainFiles files;
  files.checkpoint = folder / "latest.checkpoint";
  files.log = folder / "log.jsonl";
  StoppingReporter stopping(58);
  EXPECT_THROW(Train(scene, options, 3, files, MakeCpuBackend().get(), stopping), Interrupted);
  EXPECT_TRUE(ReadCheckpoint(files.checkpoint).cursor.foreground_frozen);
  Reporter silent;
  EXPECT_TRUE(Train(scene, options, 3, files, MakeCpuBackend().get(), silent).foreground_frozen);
  const std::vector<nlohmann::json> sights = LinesOf(folder.Read("log.jsonl"), "sights");
  ASSERT_EQ(sights.size(), 1U);
  EXPECT_EQ(sights[0]["iteration"], 60);
  EXPECT_EQ(sights[0]["cameras"], 2);
  EXPECT_EQ(sights[0]["photos"], 26);
}

TEST(Train, OtherSettingsStartAnew) {
  const TrainingScene scene = MakeSmallScene(TrainMode::kS2gs, 64, 48, 1, 5);
  const TrainOptions options = QuickOptions(20);
  const TemporaryFolder folder;
  TrainFiles files;
  files.checkpoint = folder / "latest.checkpoint";
  files.settings = "a";
  StoppingReporter stopping(10);
  EXPECT_THROW(Train(scene, options, 3, files, MakeCpuBackend().get(), stopping), Interrupted);
  // Another seed is another training, too.
  for (const auto& [settings, seed] : {std::pair("b", 3), std::pair("a", 4)}) {
    files.settings = settings;
    Listener listener;
    const TrainResult result = Train(scene, options, seed, files, MakeCpuBackend().get(), listener);
    EXPECT_THAT(listener.warnings, testing::HasSubstr("was made with other options or photos"));
    EXPECT_THAT(listener.infos, testing::Not(testing::HasSubstr("going on")));
    Reporter silent;
    ExpectSameGaussians(result.gaussians,
                        Train(scene, options, seed, {}, MakeCpuBackend().get(), silent).gaussians);
  }
}

// What is said of a run, by its own numbers.
TEST(Train, SaysHowFarItIs) {
  const TrainingScene scene = MakeSmallScene(TrainMode::kS2gs, 48, 36, 2, 10);
  TrainOptions options = QuickOptions(100);
  options.num_measurements = 2;
  options.stop_gain_pct = 0;
  const TemporaryFolder folder;
  TrainFiles files;
  files.log = folder / "log.jsonl";
  Listener listener;
  const TrainResult result = Train(scene, options, 3, files, MakeCpuBackend().get(), listener);
  const std::string log = folder.Read("log.jsonl");
  const std::vector<nlohmann::json> losses = LinesOf(log, "loss");
  ASSERT_EQ(losses.size(), 100U);  // one each of 200 parts of the run, at most each iteration
  for (size_t i = 0; i < losses.size(); ++i) {
    EXPECT_EQ(losses[i]["iteration"], i + 1);
    EXPECT_NEAR(losses[i]["progress"].get<double>(), static_cast<double>(i + 1) / 100, 1e-9);
  }
  EXPECT_EQ(losses.back()["count"], result.gaussians.size());
  // One message each twentieth of the run, and the state of the last.
  size_t messages = 0;
  for (size_t at = 0; (at = listener.infos.find("iteration ", at)) != std::string::npos; ++at) ++messages;
  EXPECT_EQ(messages, 20U) << listener.infos;
  EXPECT_THAT(listener.infos, testing::HasSubstr("iteration 50, 50 %: loss "));
  EXPECT_THAT(listener.infos, testing::HasSubstr("iteration 100, 100 %: loss "));
  const std::string gaussians = ", " + std::to_string(result.gaussians.size()) + " Gaussians, ";
  EXPECT_THAT(listener.infos, testing::HasSubstr(gaussians));
  // Held-out photos are measured after a hundredth of the run and at its end.
  const std::vector<nlohmann::json> held_out = LinesOf(log, "held_out");
  ASSERT_EQ(held_out.size(), 2U);
  EXPECT_EQ(held_out[0]["iteration"], 1);
  EXPECT_EQ(held_out[1]["iteration"], 100);
  EXPECT_EQ(held_out[1]["psnr_db"].get<double>(), result.held_out->psnr);
  // What was decided, with its figures.
  const std::vector<nlohmann::json> decisions = LinesOf(log, "decision");
  std::string text;
  for (const nlohmann::json& decision : decisions) text += decision.dump() + "\n";
  EXPECT_THAT(text, testing::HasSubstr("\"part\":\"sh_bands\""));
  EXPECT_THAT(text, testing::HasSubstr("asked for: training runs to its end"));
  EXPECT_THAT(text, testing::HasSubstr("4 photos held out"));
}

// Two photos beside each other tell no more than a colour and a slope: what is left out is said with its
// share.
TEST(Train, LeavesOutBandsThatNoPhotoTells) {
  TrainingScene scene = MakeSmallScene(TrainMode::kS2gs, 40, 30, 1, 30);
  scene.photos.resize(2);
  for (ScenePhoto& photo : scene.photos) photo.held_out = false;
  TrainOptions options = QuickOptions(20);
  options.only_told_bands = true;
  const TemporaryFolder folder;
  TrainFiles files;
  files.log = folder / "log.jsonl";
  Listener listener;
  Train(scene, options, 1, files, MakeCpuBackend().get(), listener);
  nlohmann::json bands;
  for (const nlohmann::json& decision : LinesOf(folder.Read("log.jsonl"), "decision")) {
    if (decision["part"] == "sh_bands") bands = decision;
  }
  ASSERT_TRUE(bands.is_object());
  EXPECT_EQ(bands["left_out"], true);
  // 3 (1 + 3 + 5 + 7) numbers with all bands, 3 (1 + 3) with the first two.
  EXPECT_EQ(bands["reason"], "the photos tell bands up to 1 alone");
  EXPECT_EQ(bands["saving"], "36 of 48 numbers of each Gaussian's colour are not learnt");
  EXPECT_THAT(listener.infos, testing::HasSubstr("the photos tell bands up to 1 alone: band 2 adds"));
}

// At four fifths of the time for growth a model of the budget's strategy has its bound, half of the way
// before it half of what is missing.
TEST(Train, GrowsAlongItsBudget) {
  const TrainingScene scene = MakeSmallScene(TrainMode::kS2gs, 48, 36, 2, 8);
  TrainOptions options = QuickOptions(200);
  options.densify_from = 0.1;
  options.densify_until = 0.6;
  options.densify_every = 2;
  options.max_gaussians = 2000;
  options.min_opacity = 0;
  options.unseen_weight = options.unseen_static_weight = 0;
  options.use_rotating_region = options.use_turn_evidence = false;
  const TemporaryFolder folder;
  TrainFiles files;
  files.log = folder / "log.jsonl";
  Reporter silent;
  Train(scene, options, 3, files, MakeCpuBackend().get(), silent);
  const std::vector<nlohmann::json> losses = LinesOf(folder.Read("log.jsonl"), "loss");
  ASSERT_EQ(losses.size(), 200U);
  const double first = losses[0]["count"].get<double>();
  for (const int iteration : {20, 40, 60, 80, 100, 120, 200}) {
    const double share = std::clamp((iteration / 200.0 - 0.1) / 0.4, 0.0, 1.0);
    const double expected = first + share * (2000 - first);
    EXPECT_NEAR(losses[iteration - 1]["count"].get<double>(), expected, 0.02 * expected + 8) << iteration;
  }
}

TEST(Train, WithMasksTheRotatingPartAlone) {
  const TrainingScene scene = MakeSmallScene(TrainMode::kMasks, 80, 60, 2, 12);
  Reporter silent;
  const TrainResult result = Train(scene, QuickOptions(300), 1, {}, MakeCpuBackend(1).get(), silent);
  ASSERT_TRUE(result.held_out.has_value());
  EXPECT_GT(result.held_out->object_psnr, 15);
  EXPECT_GT(result.held_out->mask_iou, 0.9);
}

TEST(Train, AStaticSceneWithoutATable) {
  // A scene whose object stands still: the object's frame is the world's.
  TrainingScene scene = MakeSmallScene(TrainMode::kStatic, 64, 48, 4, 2);
  scene.photos[0].held_out = true;
  Reporter silent;
  const TrainResult result = Train(scene, QuickOptions(200), 1, {}, MakeCpuBackend().get(), silent);
  for (const float logit : result.gaussians.foreground_logit) EXPECT_TRUE(std::isfinite(logit));
  ASSERT_TRUE(result.held_out.has_value());
  EXPECT_GT(result.held_out->psnr, 8);
}

void ExpectFinite(const Gaussians& g) {
  for (const std::vector<float>* rows :
       {&g.centre, &g.log_scale, &g.rotation, &g.opacity_logit, &g.sh_dc, &g.sh_rest, &g.foreground_logit}) {
    for (const float value : *rows) ASSERT_TRUE(std::isfinite(value));
  }
}

TEST(Train, OneAndTwoPhotosAndBlackOnes) {
  for (const size_t count : {1U, 2U, 5U}) {
    TrainingScene scene = MakeSmallScene(TrainMode::kS2gs, 40, 30, 1, 5);
    scene.photos.resize(count);
    for (ScenePhoto& photo : scene.photos) {
      photo.held_out = false;
      if (count == 5) std::fill(photo.image.pixels.begin(), photo.image.pixels.end(), uint8_t{0});
    }
    Reporter silent;
    TrainOptions options = QuickOptions(150);
    const TrainResult result = Train(scene, options, 1, {}, MakeCpuBackend().get(), silent);
    ExpectFinite(result.gaussians);
    EXPECT_LE(result.gaussians.size(), 2000U);
  }
}

TEST(Train, WithoutAnyPoints) {
  TrainingScene scene = MakeSmallScene(TrainMode::kS2gs, 40, 30, 2, 6);
  scene.points.clear();
  scene.region.reset();
  Reporter silent;
  TrainOptions options = QuickOptions(60);
  ExpectFinite(Train(scene, options, 1, {}, MakeCpuBackend().get(), silent).gaussians);
  options.initial.init = InitialPoints::kRandom;
  options.initial.num_random_points = 500;
  ExpectFinite(Train(scene, options, 1, {}, MakeCpuBackend().get(), silent).gaussians);
}

TEST(Train, RunsThroughItsCourseInTheTimeGiven) {
  const TrainingScene scene = MakeSmallScene(TrainMode::kS2gs, 40, 30, 1, 6);
  TrainOptions options = QuickOptions(1'000'000);
  options.max_seconds = 1;
  Reporter silent;
  const TrainResult result = Train(scene, options, 1, {}, MakeCpuBackend().get(), silent);
  EXPECT_LT(result.iterations, 1'000'000);
  EXPECT_GE(result.wall_seconds, 0.9);
  EXPECT_TRUE(result.foreground_frozen);
}

}  // namespace
}  // namespace s2gs
