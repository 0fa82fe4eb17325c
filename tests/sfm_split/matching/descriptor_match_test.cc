#include "sfm_split/matching/descriptor_match.h"

#include <gmock/gmock.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <random>
#include <string>
#include <vector>

#include "sfm_split/matching/descriptor_kernel.h"

namespace s2gs {

void PrintTo(const FeatureMatch& match, std::ostream* out) {
  *out << match.point2D_idx1 << "-" << match.point2D_idx2;
}

namespace {

using Descriptors = std::vector<uint8_t>;  // n x 128
using Matches = FeatureMatches;

size_t Num(const Descriptors& descriptors) { return descriptors.size() / kDescriptorSize; }

using DotTable = Eigen::MatrixXd;  // rows of one image x rows of the other

Eigen::MatrixXd AsMatrix(const Descriptors& descriptors) {
  const Eigen::Map<const Eigen::Matrix<uint8_t, kDescriptorSize, Eigen::Dynamic>> columns(
      descriptors.data(), kDescriptorSize, static_cast<Eigen::Index>(Num(descriptors)));
  return columns.cast<double>().transpose();
}

// The rule in plain words, one direction: best and second best by squared-norm-512 angles, in double.
std::vector<int> NaiveOneWay(const DotTable& dots, const DescriptorMatchOptions& options) {
  std::vector<int> best_of(dots.rows(), -1);
  for (int i = 0; i < dots.rows(); ++i) {
    double best_dot = 0.0;
    double second_dot = 0.0;
    for (int j = 0; j < dots.cols(); ++j) {
      if (dots(i, j) > best_dot) {
        second_dot = best_dot;
        best_dot = dots(i, j);
        best_of[i] = j;
      } else {
        second_dot = std::max(second_dot, dots(i, j));
      }
    }
    const double best = std::acos(std::min(best_dot / (512.0 * 512.0), 1.0));
    const double second = std::acos(std::min(second_dot / (512.0 * 512.0), 1.0));
    if (best > options.max_distance || best >= options.max_ratio * second) best_of[i] = -1;
  }
  return best_of;
}

Matches Naive(const Descriptors& a, const Descriptors& b, const DescriptorMatchOptions& options) {
  const DotTable dots = AsMatrix(a) * AsMatrix(b).transpose();  // sums of integers: exact in double
  const std::vector<int> forward = NaiveOneWay(dots, options);
  const std::vector<int> backward = NaiveOneWay(dots.transpose(), options);
  Matches matches;
  for (size_t i = 0; i < forward.size(); ++i) {
    if (forward[i] < 0) continue;
    if (options.cross_check && backward[forward[i]] != static_cast<int>(i)) continue;
    matches.push_back({static_cast<uint32_t>(i), static_cast<uint32_t>(forward[i])});
  }
  return matches;
}

// A descriptor as COLMAP makes it: square root of an L1-normalised histogram, times 512. A larger `peak`
// concentrates it in fewer bytes.
void AppendRandom(std::mt19937* rng, double peak, Descriptors* descriptors) {
  std::gamma_distribution<double> gamma(1.0 / peak);
  double histogram[kDescriptorSize];
  double sum = 1e-9;
  for (double& bin : histogram) sum += bin = gamma(*rng);
  for (const double bin : histogram) {
    descriptors->push_back(static_cast<uint8_t>(std::min(255.0, std::round(512.0 * std::sqrt(bin / sum)))));
  }
}

Descriptors Random(std::mt19937* rng, size_t num) {
  Descriptors descriptors;
  for (size_t i = 0; i < num; ++i) AppendRandom(rng, i % 5 == 0 ? 20.0 : 2.0, &descriptors);
  return descriptors;
}

// `num` descriptors, of which about half are noisy copies of some of `from`.
Descriptors NoisyCopies(const Descriptors& from, size_t num, std::mt19937* rng) {
  Descriptors descriptors = Random(rng, num);
  std::normal_distribution<double> noise(0.0, 8.0);
  for (size_t i = 0; i < num && Num(from) > 0; ++i) {
    if ((*rng)() % 2 == 0) continue;
    const size_t source = (*rng)() % Num(from);
    for (int k = 0; k < kDescriptorSize; ++k) {
      const double value = from[source * kDescriptorSize + k] + noise(*rng);
      descriptors[i * kDescriptorSize + k] = static_cast<uint8_t>(std::clamp(value, 0.0, 255.0));
    }
  }
  return descriptors;
}

std::vector<MatchInstructions> Available() {
  std::vector<MatchInstructions> available;
  for (const auto instructions :
       {MatchInstructions::kPortable, MatchInstructions::kAvx2, MatchInstructions::kAvx512Vnni}) {
    if (MatchInstructionsAvailable(instructions)) available.push_back(instructions);
  }
  return available;
}

// Every instruction set and one and three threads must give exactly `expected`.
void ExpectMatches(const Descriptors& a, const Descriptors& b, const DescriptorMatchOptions& options,
                   const Matches& expected) {
  const PackedDescriptors packed_a(a.data(), Num(a));
  const PackedDescriptors packed_b(b.data(), Num(b));
  for (const MatchInstructions instructions : Available()) {
    for (const int num_threads : {1, 3}) {
      DescriptorMatcher matcher(options, num_threads, instructions);
      Matches matches = {{7, 7}};
      matcher.Match(packed_a, packed_b, &matches);
      EXPECT_EQ(matches, expected) << "instructions " << static_cast<int>(instructions) << ", " << num_threads
                                   << " threads";
    }
  }
}

void ExpectAsNaive(const Descriptors& a, const Descriptors& b, const DescriptorMatchOptions& options = {}) {
  ExpectMatches(a, b, options, Naive(a, b, options));
}

TEST(DescriptorMatch, AgreesWithNaiveForManySizes) {
  std::mt19937 rng(1);
  // Around the sizes of tiles (6, 8), groups (16, 32), rows (240) and columns (256) of a block.
  const size_t sizes[] = {0, 1, 2, 5, 6, 7, 15, 16, 17, 33, 239, 241, 255, 257, 500};
  size_t num_matches = 0;
  for (const size_t num_a : sizes) {
    const Descriptors a = Random(&rng, num_a);
    for (const size_t num_b : sizes) {
      if (num_a * num_b > 70000 && num_a != num_b) continue;
      const Descriptors b = NoisyCopies(a, num_b, &rng);
      SCOPED_TRACE(std::to_string(num_a) + " x " + std::to_string(num_b));
      ExpectAsNaive(a, b);
      num_matches += Naive(a, b, {}).size();
    }
  }
  EXPECT_GT(num_matches, 500U);  // the comparison is not between empty lists
}

TEST(DescriptorMatch, AgreesWithNaiveForOtherOptions) {
  std::mt19937 rng(2);
  const Descriptors a = Random(&rng, 300);
  const Descriptors b = NoisyCopies(a, 280, &rng);
  for (const double max_ratio : {0.5, 0.9, 1.0}) {
    for (const double max_distance : {0.2, 0.7, 3.0}) {
      for (const bool cross_check : {false, true}) {
        ExpectAsNaive(a, b, {max_ratio, max_distance, cross_check});
      }
    }
  }
}

TEST(DescriptorMatch, AllWeightsOccurAndAgree) {
  std::mt19937 rng(3);
  Descriptors a;
  int count[PackedDescriptors::kNumWeights] = {};
  for (int i = 0; i < 600; ++i) AppendRandom(&rng, 1.0 + i % 6 * 6.0, &a);
  for (size_t i = 0; i < Num(a); ++i) {
    uint8_t packed[kDescriptorSize];
    for (int k = 0; k < kDescriptorSize; ++k) packed[k] = a[i * kDescriptorSize + DescriptorPermutation(k)];
    ++count[DescriptorWeight(packed)];
  }
  EXPECT_THAT(count, ::testing::Each(::testing::Gt(20)));
  ExpectAsNaive(a, NoisyCopies(a, 600, &rng));
}

TEST(DescriptorMatch, PermutationIsOne) {
  std::vector<int> sources;
  for (int i = 0; i < kDescriptorSize; ++i) sources.push_back(DescriptorPermutation(i));
  std::sort(sources.begin(), sources.end());
  for (int i = 0; i < kDescriptorSize; ++i) EXPECT_EQ(sources[i], i);
}

// Lightest and heaviest descriptors at the very bounds of exact 16-bit sums, dot products known in advance.
TEST(DescriptorMatch, DotProductsAreExactAtTheBounds) {
  std::mt19937 rng(4);
  for (const MatchInstructions instructions : Available()) {
    for (int trial = 0; trial < 200; ++trial) {
      // A lane of 16 bytes with 65535 of squares at most, or pairs of bytes that sum to 258.
      Descriptors rows(kDescriptorSize * 16);
      Descriptors columns(kDescriptorSize * 16);
      for (Descriptors* descriptors : {&rows, &columns}) {
        for (uint8_t& byte : *descriptors) {
          const int kind = static_cast<int>(rng() % 4);
          byte = static_cast<uint8_t>(kind == 0 ? 127 : kind == 1 ? 129 : kind == 2 ? 0 : rng() % 256);
          if (trial % 2 == 0) byte = static_cast<uint8_t>(byte > 63 ? 63 + byte % 2 : byte);
        }
      }
      const PackedDescriptors packed_rows(rows.data(), 16);
      const PackedDescriptors packed_columns(columns.data(), 16);
      DescriptorMatchOptions options;
      options.max_distance = 3.0;
      options.max_ratio = 1.0;
      options.cross_check = false;
      DescriptorMatcher matcher(options, 1, instructions);
      Matches matches;
      matcher.Match(packed_rows, packed_columns, &matches);
      EXPECT_EQ(matches, Naive(rows, columns, options)) << trial;
    }
  }
}

TEST(DescriptorMatch, SaturatedBytes) {
  // 128 x 255 with itself: the largest dot product there is. Clamped, so at distance 0 like any other that
  // exceeds 512^2: no match beside a second one, a match when alone.
  const Descriptors full(kDescriptorSize, 255);
  ExpectMatches(full, full, {}, {{0, 0}});
  Descriptors two = full;
  two.insert(two.end(), full.begin(), full.end());
  ExpectMatches(full, two, {}, {});
  Descriptors full_and_zero = full;
  full_and_zero.resize(2 * kDescriptorSize, 0);
  ExpectMatches(full_and_zero, full_and_zero, {}, {{0, 0}});  // zero has no nearest neighbour
  ExpectAsNaive(Descriptors(kDescriptorSize * 40, 255), Descriptors(kDescriptorSize * 300, 255));
}

TEST(DescriptorMatch, DuplicatesOnOneSideMatchNothing) {
  std::mt19937 rng(5);
  const Descriptors a = Random(&rng, 20);
  Descriptors b = a;
  b.insert(b.end(), a.begin(), a.begin() + 5 * kDescriptorSize);  // the first five twice
  Matches expected;
  for (uint32_t i = 5; i < 20; ++i) expected.push_back({i, i});
  ExpectMatches(a, b, {}, expected);
  ExpectAsNaive(a, b);
}

TEST(DescriptorMatch, TiesAcrossWeightsNeverMatch) {
  Descriptors a(kDescriptorSize, 0);
  a[0] = 100;
  a[9] = 200;
  // The same dot product with `a` from descriptors of every weight, which lie in different groups.
  Descriptors b;
  for (int i = 0; i < 600; ++i) {
    Descriptors one(kDescriptorSize, 0);
    one[9] = 40;
    if (i % 3 != 0) one[30] = 200;
    if (i % 3 == 2) one[31 + i % 60] = one[100] = 255;
    b.insert(b.end(), one.begin(), one.end());
  }
  const DescriptorMatchOptions one_way = {1.0, 3.0, false};
  ExpectMatches(a, b, one_way, {});
  // Each of b has only `a` to match, which has no best among them.
  const Matches backward = Naive(b, a, one_way);
  ASSERT_EQ(backward.size(), 600U);
  ExpectMatches(b, a, one_way, backward);
  ExpectMatches(b, a, {1.0, 3.0, true}, {});
}

TEST(DescriptorMatch, SubsetEqualsMatchingTheSubsetAlone) {
  std::mt19937 rng(6);
  const Descriptors a = Random(&rng, 400);
  const Descriptors b = NoisyCopies(a, 400, &rng);
  std::vector<uint32_t> subset_a;
  std::vector<uint32_t> subset_b;
  Descriptors part_a;
  Descriptors part_b;
  for (uint32_t i = 0; i < 400; ++i) {
    const auto append = [i](const Descriptors& from, std::vector<uint32_t>* subset, Descriptors* part) {
      subset->push_back(i);
      part->insert(part->end(), from.begin() + i * kDescriptorSize, from.begin() + (i + 1) * kDescriptorSize);
    };
    if (rng() % 3 == 0) append(a, &subset_a, &part_a);
    if (rng() % 2 == 0) append(b, &subset_b, &part_b);
  }
  Matches expected = Naive(part_a, part_b, {});
  ASSERT_GT(expected.size(), 10U);
  for (FeatureMatch& match : expected) match = {subset_a[match.point2D_idx1], subset_b[match.point2D_idx2]};
  const PackedDescriptors packed_a(a.data(), 400, subset_a);
  const PackedDescriptors packed_b(b.data(), 400, subset_b);
  EXPECT_EQ(packed_a.size(), subset_a.size());
  DescriptorMatcher matcher({}, 2);
  Matches matches;
  matcher.Match(packed_a, packed_b, &matches);
  EXPECT_EQ(matches, expected);
}

TEST(DescriptorMatch, ManyPairsAtOnceEqualOneByOne) {
  std::mt19937 rng(7);
  const Descriptors first = Random(&rng, 150);
  std::vector<PackedDescriptors> images;
  for (const size_t num : {150, 0, 1, 90, 260, 33, 170}) {
    const Descriptors descriptors = NoisyCopies(first, num, &rng);
    images.emplace_back(descriptors.data(), num);
  }
  std::vector<DescriptorMatcher::Job> jobs;
  for (const PackedDescriptors& a : images) {
    for (const PackedDescriptors& b : images) jobs.push_back({&a, &b});
  }
  DescriptorMatcher matcher({}, 3);
  std::vector<Matches> many;
  matcher.MatchAll(jobs, &many);
  ASSERT_EQ(many.size(), jobs.size());
  Matches one;
  size_t total = 0;
  for (size_t i = 0; i < jobs.size(); ++i) {
    matcher.Match(*jobs[i].image1, *jobs[i].image2, &one);
    EXPECT_EQ(many[i], one) << i;
    total += one.size();
  }
  EXPECT_GT(total, 500U);
  jobs.resize(2);  // fewer pairs than threads: threads inside a pair
  std::vector<Matches> few;
  matcher.MatchAll(jobs, &few);
  ASSERT_EQ(few.size(), 2U);
  EXPECT_EQ(few[0], many[0]);
  EXPECT_EQ(few[1], many[1]);
}

TEST(DescriptorMatch, OptionsOutsideTheirBoundsAreNamed) {
  EXPECT_FALSE(DescriptorMatchOptions{}.Check().has_value());
  for (const double bad : {0.0, -1.0, 1.01, std::nan("")}) {
    DescriptorMatchOptions options;
    options.max_ratio = bad;
    ASSERT_TRUE(options.Check().has_value()) << bad;
    EXPECT_EQ(options.Check()->field, "max_ratio");
  }
  for (const double bad : {0.0, -1.0, HUGE_VAL, std::nan("")}) {
    DescriptorMatchOptions options;
    options.max_distance = bad;
    ASSERT_TRUE(options.Check().has_value()) << bad;
    EXPECT_EQ(options.Check()->field, "max_distance");
  }
}

}  // namespace
}  // namespace s2gs
