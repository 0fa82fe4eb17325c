#include "s2gs/checkpoint.h"

#include <gtest/gtest.h>

#include <sstream>
#include <string>

#include "s2gs/core/rng.h"
#include "sfm_split/base/error.h"
#include "tests/s2gs/expect_gaussians.h"
#include "tests/support/bad_input.h"

namespace s2gs {
namespace {

Gaussians Numbers(size_t count, uint64_t seed) {
  Gaussians g;
  g.Resize(count);
  uint64_t index = 0;
  for (std::vector<float>* rows :
       {&g.centre, &g.log_scale, &g.rotation, &g.opacity_logit, &g.sh_dc, &g.sh_rest, &g.foreground_logit}) {
    for (float& value : *rows) value = UnitFloat(RandomBits(seed, 0, index++).words[0]);
  }
  g.sh_degree = 2;
  return g;
}

Checkpoint Example(size_t count) {
  Checkpoint c;
  c.cursor.iteration = 1234;
  c.cursor.progress = 0.25;
  c.cursor.seed = 77;
  c.cursor.wall_seconds = 1.5;
  c.cursor.cpu_seconds = 2.5;
  c.cursor.measuring_seconds = 0.5;
  c.cursor.foreground_frozen = true;
  c.cursor.last_densified = 1200;
  c.cursor.last_reset = 900;
  c.cursor.initial_count = 9;
  c.cursor.neighbours_turn = 3;
  c.cursor.settings = "a=1\nb=2\n";
  c.state.gaussians = Numbers(count, 1);
  c.state.first_moment = Numbers(count, 2);
  c.state.second_moment = Numbers(count, 3);
  c.state.gradient_sum.assign(count, 0.125F);
  c.state.view_count.assign(count, 7);
  c.state.num_neighbours = 2;
  for (size_t i = 0; i < 2 * count; ++i) c.state.neighbours.push_back(static_cast<uint32_t>(i % count));
  return c;
}

std::string Bytes(const Checkpoint& checkpoint) {
  std::ostringstream stream;
  WriteCheckpoint(stream, checkpoint);
  return stream.str();
}

Checkpoint Parse(const std::string& bytes) {
  std::istringstream stream(bytes);
  return ReadCheckpoint(stream, "x.checkpoint");
}

TEST(Checkpoint, ComesBackUnchanged) {
  const Checkpoint c = Example(3);
  const Checkpoint back = Parse(Bytes(c));
  EXPECT_EQ(back.cursor.iteration, c.cursor.iteration);
  EXPECT_EQ(back.cursor.progress, c.cursor.progress);
  EXPECT_EQ(back.cursor.seed, c.cursor.seed);
  EXPECT_EQ(back.cursor.wall_seconds, c.cursor.wall_seconds);
  EXPECT_EQ(back.cursor.cpu_seconds, c.cursor.cpu_seconds);
  EXPECT_EQ(back.cursor.measuring_seconds, c.cursor.measuring_seconds);
  EXPECT_EQ(back.cursor.foreground_frozen, c.cursor.foreground_frozen);
  EXPECT_EQ(back.cursor.last_densified, c.cursor.last_densified);
  EXPECT_EQ(back.cursor.last_reset, c.cursor.last_reset);
  EXPECT_EQ(back.cursor.initial_count, c.cursor.initial_count);
  EXPECT_EQ(back.cursor.neighbours_turn, c.cursor.neighbours_turn);
  EXPECT_EQ(back.cursor.settings, c.cursor.settings);
  ExpectSameGaussians(back.state.gaussians, c.state.gaussians);
  ExpectSameGaussians(back.state.first_moment, c.state.first_moment);
  ExpectSameGaussians(back.state.second_moment, c.state.second_moment);
  EXPECT_EQ(back.state.gradient_sum, c.state.gradient_sum);
  EXPECT_EQ(back.state.view_count, c.state.view_count);
  EXPECT_EQ(back.state.num_neighbours, c.state.num_neighbours);
  EXPECT_EQ(back.state.neighbours, c.state.neighbours);
}

TEST(CheckpointBadInput, EveryDamageIsFound) {
  // The checksum leaves no damage unseen: not one damaged file is accepted.
  ForEachDamage(Bytes(Example(1)), [](const std::string& damaged, const std::string& description) {
    const ScopedAllocationLimit limit(1 << 16);
    ExpectUserError([&] { Parse(damaged); }, {"x.checkpoint"}, description);
  });
}

TEST(CheckpointBadInput, HostileContentWithARightChecksum) {
  // A neighbour that does not exist.
  Checkpoint c = Example(2);
  c.state.neighbours[1] = 2;
  ExpectUserError([&] { Parse(Bytes(c)); }, {"x.checkpoint", "neighbour"});
  c = Example(2);
  c.cursor.progress = 2;
  ExpectUserError([&] { Parse(Bytes(c)); }, {"x.checkpoint", "progress"});
  c = Example(2);
  c.cursor.held_out_course.Add(1.5, 0.1);
  ExpectUserError([&] { Parse(Bytes(c)); }, {"x.checkpoint", "held-out"});
  c = Example(2);
  c.cursor.held_out_course.Add(0, 0.1);
  c.cursor.held_out_course.Add(1, 0.1);  // both ends of the run are points of it
  EXPECT_NO_THROW(Parse(Bytes(c)));
  c = Example(2);
  c.state.gaussians.sh_degree = 4;
  ExpectUserError([&] { Parse(Bytes(c)); }, {"x.checkpoint", "degree"});
}

TEST(CheckpointBadInput, AnotherVersion) {
  ExpectUserError([&] { Parse(WithInteger(Bytes(Example(1)), 8, 4, 99)); }, {"x.checkpoint", "version 99"});
}

}  // namespace
}  // namespace s2gs
