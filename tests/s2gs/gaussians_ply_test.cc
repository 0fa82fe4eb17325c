#include "s2gs/gaussians_ply.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <sstream>
#include <string>
#include <vector>

#include "s2gs/core/rng.h"
#include "sfm_split/base/error.h"
#include "sfm_split/scene/io/ply_file.h"
#include "tests/support/bad_input.h"

namespace s2gs {
namespace {

Gaussians Example(size_t count) {
  Gaussians g;
  g.Resize(count);
  uint64_t index = 0;
  for (std::vector<float>* rows :
       {&g.centre, &g.log_scale, &g.rotation, &g.opacity_logit, &g.sh_dc, &g.sh_rest, &g.foreground_logit}) {
    for (float& value : *rows) value = 4 * UnitFloat(RandomBits(1, 2, index++).words[0]) - 2;
  }
  g.sh_degree = 3;
  return g;
}

std::string Bytes(const Gaussians& gaussians, const GaussianPlyOptions& options = {}) {
  std::ostringstream stream;
  WriteGaussianPly(stream, gaussians, options);
  return stream.str();
}

Gaussians Parse(const std::string& bytes) {
  std::istringstream stream(bytes);
  return ReadGaussianPly(stream, "x.ply");
}

TEST(GaussianPly, KeepsEverythingButTheQuaternionsLength) {
  const Gaussians g = Example(5);
  const Gaussians back = Parse(Bytes(g));
  EXPECT_EQ(back.centre, g.centre);
  EXPECT_EQ(back.log_scale, g.log_scale);
  EXPECT_EQ(back.opacity_logit, g.opacity_logit);
  EXPECT_EQ(back.sh_dc, g.sh_dc);
  EXPECT_EQ(back.sh_rest, g.sh_rest);
  EXPECT_EQ(back.sh_degree, 3);
  for (size_t i = 0; i < g.size(); ++i) {
    // Logit to p and back: 1e-6 measured.
    EXPECT_NEAR(back.foreground_logit[i], g.foreground_logit[i], 1e-5);
    float norm = 0;
    for (int j = 0; j < 4; ++j) norm += g.rotation[4 * i + j] * g.rotation[4 * i + j];
    for (int j = 0; j < 4; ++j) {
      EXPECT_NEAR(back.rotation[4 * i + j], g.rotation[4 * i + j] / std::sqrt(norm), 1e-6);
    }
  }
}

TEST(GaussianPly, HasTheReferenceProgramsColumnsInTheirOrder) {
  std::istringstream stream(Bytes(Example(2)));
  const PlyFile file = ReadPly(stream, "x.ply");
  std::vector<std::string> names;
  for (const PlyProperty& property : file.elements.at(0).properties) {
    names.push_back(property.name);
    EXPECT_EQ(property.type(), PlyType::kFloat32);
  }
  std::vector<std::string> expected = {"x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"};
  for (int i = 0; i < 45; ++i) expected.push_back("f_rest_" + std::to_string(i));
  for (const char* name :
       {"opacity", "scale_0", "scale_1", "rot_0", "rot_1", "rot_2", "rot_3", "foreground"}) {
    expected.emplace_back(name);
  }
  EXPECT_EQ(names, expected);
}

TEST(GaussianPly, StoresHigherBandsChannelByChannel) {
  Gaussians g = Example(1);
  for (int k = 0; k < 15; ++k) {
    for (int c = 0; c < 3; ++c) g.sh_rest[3 * k + c] = static_cast<float>(100 * c + k);
  }
  std::istringstream stream(Bytes(g));
  const PlyFile file = ReadPly(stream, "x.ply");
  const auto value = [&](int i) {
    return PlyFloats(file.elements[0].Find("f_rest_" + std::to_string(i))->values)[0];
  };
  EXPECT_EQ(value(0), 0);
  EXPECT_EQ(value(14), 14);
  EXPECT_EQ(value(15), 100);
  EXPECT_EQ(value(44), 214);
}

TEST(GaussianPly, WritesTheRotatingOnesAlone) {
  Gaussians g = Example(4);
  g.foreground_logit = {-5, 1.38F, 1.39F, 5};  // tau = .8 is at 1.3863
  GaussianPlyOptions options;
  options.foreground_only = true;
  const Gaussians back = Parse(Bytes(g, options));
  ASSERT_EQ(back.size(), 2U);
  EXPECT_EQ(back.centre[0], g.centre[6]);
  EXPECT_EQ(back.centre[3], g.centre[9]);
}

TEST(GaussianPly, ViewersOf3dGaussiansGetAThirdScale) {
  GaussianPlyOptions options;
  options.layout = GaussianPlyLayout::k3dgs;
  const std::string bytes = Bytes(Example(2), options);
  EXPECT_NE(bytes.find("property float scale_2\n"), std::string::npos);
  EXPECT_EQ(Parse(bytes).size(), 2U);
}

TEST(GaussianPly, ReadsLowerDegreesAndFilesWithoutForeground) {
  std::ostringstream text;
  text << "ply\nformat ascii 1.0\nelement vertex 1\n";
  for (const char* name :
       {"x",        "y",        "z",        "opacity",  "f_dc_0",   "f_dc_1",   "f_dc_2",   "scale_0",
        "scale_1",  "rot_0",    "rot_1",    "rot_2",    "rot_3",    "f_rest_0", "f_rest_1", "f_rest_2",
        "f_rest_3", "f_rest_4", "f_rest_5", "f_rest_6", "f_rest_7", "f_rest_8"}) {
    text << "property float " << name << "\n";
  }
  text << "end_header\n1 2 3 4 5 6 7 8 9 1 0 0 0 10 11 12 20 21 22 30 31 32\n";
  const Gaussians g = Parse(text.str());
  EXPECT_EQ(g.sh_degree, 1);
  EXPECT_THAT(std::vector<float>(g.sh_rest.begin(), g.sh_rest.begin() + 9),
              testing::ElementsAre(10, 20, 30, 11, 21, 31, 12, 22, 32));
  EXPECT_LT(g.foreground_logit[0], -10);
}

TEST(GaussianPlyBadInput, DamagedFilesAreRefusedOrRead) {
  Gaussians g = Example(1);
  const std::string bytes = Bytes(g);
  // The header of 1,500 bytes has the same few kinds of words again and again: every byte of it is cut off,
  // every bit of the data and of the header's begin and end is flipped.
  for (size_t cut = 0; cut < bytes.size(); ++cut) {
    ExpectOkOrUserError([&] { Parse(bytes.substr(0, cut)); }, "x.ply", "cut to " + std::to_string(cut));
  }
  const size_t data = bytes.find("end_header\n") + 11;
  for (size_t at = 0; at < bytes.size(); ++at) {
    if (at > 120 && at + 120 < data) continue;
    for (int bit = 0; bit < 8; ++bit) {
      std::string damaged = bytes;
      damaged[at] = static_cast<char>(damaged[at] ^ (1 << bit));
      const ScopedAllocationLimit limit(1 << 20);
      ExpectOkOrUserError([&] { Parse(damaged); }, "x.ply", "bit at " + std::to_string(at));
    }
  }
}

TEST(GaussianPlyBadInput, HostileCountsAndNumbers) {
  for (const char* count : {"9223372036854775808", "18446744073709551615", "2147483648"}) {
    std::string bytes = Bytes(Example(1));
    const size_t at = bytes.find("vertex 1");
    bytes.replace(at, 8, std::string("vertex ") + count);
    const ScopedAllocationLimit limit(1 << 20);
    ExpectUserError([&] { Parse(bytes); }, {"x.ply"}, count);
  }
  Gaussians g = Example(1);
  g.centre[1] = std::numeric_limits<float>::quiet_NaN();
  ExpectUserError([&] { Parse(Bytes(g)); }, {"x.ply", "y is not a finite number"});
  g = Example(1);
  std::string no_rotation = Bytes(g);
  ASSERT_GT(no_rotation.size(), 20U);
  // rot_0..3 are the four floats before foreground.
  no_rotation.replace(no_rotation.size() - 20, 16, std::string(16, '\0'));
  ExpectUserError([&] { Parse(no_rotation); }, {"x.ply", "rotation is zero"});
}

}  // namespace
}  // namespace s2gs
