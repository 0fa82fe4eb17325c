// Times the descriptor matcher on a database's images, against the processor's own bound, and compares the
// matches with those of another program.
//
//   match_bench DATABASE PAIRS [THREADS]             PAIRS: lines "NAME1 NAME2"
//   match_bench --match DATABASE PAIRS [THREADS]     writes the matches table, as the program does
//   match_bench --agreement DATABASE1 DATABASE2      matches tables of the same images and pairs

#include <omp.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <map>
#include <set>
#include <string>
#include <utility>
#include <vector>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "sfm_split/base/stopwatch.h"
#include "sfm_split/matching/descriptor_match.h"
#include "sfm_split/matching/image_similarity.h"
#include "sfm_split/matching/match_images.h"
#include "sfm_split/matching/pair_plan.h"
#include "sfm_split/scene/io/colmap_database.h"

namespace s2gs {
namespace {

double Median(std::vector<double> values) {
  if (values.empty()) return 0.0;
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2),
                   values.end());
  return values[values.size() / 2];
}

#if defined(__x86_64__)
// 8-bit multiply-adds a second of one thread that does nothing else: the instruction and one addition of its
// result, on twelve independent sums.
__attribute__((target("avx2"))) double PeakAvx2() {
  constexpr int64_t kRounds = 20'000'000;
  __m256i sum[12];
  for (__m256i& s : sum) s = _mm256_setzero_si256();
  __m256i a = _mm256_set1_epi8(1);
  const double start = SteadySeconds();
  for (int64_t i = 0; i < kRounds; ++i) {
#pragma GCC unroll 12
    for (__m256i& s : sum) {
      s = _mm256_add_epi16(s, _mm256_maddubs_epi16(a, a));
      asm volatile("" : "+x"(s), "+x"(a));
    }
  }
  return 12.0 * kRounds * 32.0 / (SteadySeconds() - start);
}

__attribute__((target("avx512f,avx512vnni"))) double PeakAvx512Vnni() {
  constexpr int64_t kRounds = 20'000'000;
  __m512i sum[12];
  for (__m512i& s : sum) s = _mm512_setzero_si512();
  __m512i a = _mm512_set1_epi32(0x01010101);
  const double start = SteadySeconds();
  for (int64_t i = 0; i < kRounds; ++i) {
#pragma GCC unroll 12
    for (__m512i& s : sum) {
      s = _mm512_dpbusd_epi32(s, a, a);
      asm volatile("" : "+v"(s), "+v"(a));
    }
  }
  return 12.0 * kRounds * 64.0 / (SteadySeconds() - start);
}
#endif

double Peak(MatchInstructions instructions) {
#if defined(__x86_64__)
  if (instructions == MatchInstructions::kAvx2) return PeakAvx2();
  if (instructions == MatchInstructions::kAvx512Vnni) return PeakAvx512Vnni();
#endif
  (void)instructions;
  return 0.0;
}

int Time(const char* database_path, const char* pairs_path, int num_threads) {
  const ColmapDatabase database = ColmapDatabase::Open(database_path, ColmapDatabase::Access::kReadOnly);
  std::map<std::string, PackedDescriptors> images;
  std::map<std::string, uint32_t> image_ids;
  std::vector<uint32_t> all_ids;
  for (const DatabaseImage& image : database.ReadImages()) {
    image_ids[image.name] = image.image_id;
    all_ids.push_back(image.image_id);
  }
  std::ifstream stream(pairs_path);
  std::vector<DescriptorMatcher::Job> jobs;
  double pack_seconds = 0.0;
  const auto load = [&](const std::string& name) -> const PackedDescriptors* {
    const auto [entry, is_new] = images.try_emplace(name);
    if (is_new) {
      const DescriptorMatrix descriptors = database.ReadDescriptors(image_ids.at(name));
      const double start = SteadySeconds();
      entry->second = PackedDescriptors(descriptors.data(), static_cast<size_t>(descriptors.rows()));
      pack_seconds += SteadySeconds() - start;
    }
    return &entry->second;
  };
  for (std::string name1, name2; stream >> name1 >> name2;) jobs.push_back({load(name1), load(name2)});
  double work = 0.0;
  for (const DescriptorMatcher::Job& job : jobs) {
    work +=
        static_cast<double>(job.image1->size()) * static_cast<double>(job.image2->size()) * kDescriptorSize;
  }
  std::printf("%zu pairs of %zu images, %.1f G multiply-adds; packing %.2f ms an image\n", jobs.size(),
              images.size(), work * 1e-9, 1e3 * pack_seconds / static_cast<double>(images.size()));
  const std::pair<MatchInstructions, const char*> kinds[] = {
      {MatchInstructions::kPortable, "portable"},
      {MatchInstructions::kAvx2, "AVX2"},
      {MatchInstructions::kAvx512Vnni, "AVX-512 VNNI"}};
  for (const auto& [instructions, name] : kinds) {
    if (!MatchInstructionsAvailable(instructions)) continue;
    DescriptorMatcher one(DescriptorMatchOptions{}, 1, instructions);
    DescriptorMatcher many(DescriptorMatchOptions{}, num_threads, instructions);
    FeatureMatches matches;
    std::vector<double> seconds;
    std::vector<double> shares;
    size_t num_matches = 0;
    const size_t num_jobs =
        instructions == MatchInstructions::kPortable ? std::min<size_t>(jobs.size(), 3) : jobs.size();
    for (size_t i = 0; i < num_jobs; ++i) {
      const double peak = i % 8 == 0 || shares.empty() ? Peak(instructions) : 0.0;
      const double start = SteadySeconds();
      one.Match(*jobs[i].image1, *jobs[i].image2, &matches);
      seconds.push_back(SteadySeconds() - start);
      num_matches += matches.size();
      const double rate = static_cast<double>(jobs[i].image1->size()) *
                          static_cast<double>(jobs[i].image2->size()) * kDescriptorSize / seconds.back();
      if (peak > 0.0) shares.push_back(rate / peak);
    }
    std::printf("%s, 1 thread: median %.1f ms a pair", name, 1e3 * Median(seconds));
    if (!shares.empty()) std::printf(", %.0f %% of the instruction's peak", 100.0 * Median(shares));
    std::printf("; %zu matches of %zu pairs\n", num_matches, num_jobs);
    if (instructions == MatchInstructions::kPortable) continue;
    std::vector<FeatureMatches> all;
    std::vector<double> totals;
    for (int repeat = 0; repeat < 5; ++repeat) {
      const double start = SteadySeconds();
      many.MatchAll(jobs, &all);
      totals.push_back(SteadySeconds() - start);
    }
    std::printf("%s, %d threads: %.1f ms a pair (median of 5 runs over all pairs), %.0f G multiply-adds/s\n",
                name, many.num_threads(), 1e3 * Median(totals) / static_cast<double>(jobs.size()),
                1e-9 * work / Median(totals));
  }

  DescriptorMatcher matcher(DescriptorMatchOptions{}, num_threads);
  Reporter silent;
  std::map<std::string, uint32_t> by_name(image_ids.begin(), image_ids.end());
  for (const size_t num_features : {128, 256, 512}) {
    const double start = SteadySeconds();
    const SimilarityMatrix similarity = CoarseSimilarity(database, all_ids, num_features, &matcher, silent);
    const double time = SteadySeconds() - start;
    std::vector<uint32_t> name_order;  // positions in all_ids, which are in ascending id
    for (const auto& [name, id] : by_name) {
      name_order.push_back(
          static_cast<uint32_t>(std::lower_bound(all_ids.begin(), all_ids.end(), id) - all_ids.begin()));
    }
    std::vector<uint32_t> shuffled = name_order;
    uint64_t state = 1;
    for (size_t i = shuffled.size(); i > 1; --i) {
      state = state * 6364136223846793005U + 1442695040888963407U;
      std::swap(shuffled[i - 1], shuffled[(state >> 33) % i]);
    }
    std::printf(
        "similarity of all pairs by %zu features: %.2f s; agreement with names %.3f, with shuffled names "
        "%.3f\n",
        num_features, time, OrderAgreement(name_order, similarity), OrderAgreement(shuffled, similarity));
    std::map<uint32_t, std::string> name_of;
    for (const auto& [name, id] : by_name) name_of[id] = name;
    for (const int partners : {4, 8}) {
      const std::vector<ImagePair> pairs = SimilarPairs(similarity, partners);
      size_t same_prefix = 0;  // "STATION_..." names
      for (const ImagePair pair : pairs) {
        const std::string& a = name_of[all_ids[pair.first]];
        const std::string& b = name_of[all_ids[pair.second]];
        same_prefix += a.substr(0, a.find('_')) == b.substr(0, b.find('_')) ? 1 : 0;
      }
      std::printf("  %d partners: %zu pairs, %zu of one station\n", partners, pairs.size(), same_prefix);
    }
  }
  return EXIT_SUCCESS;
}

int MatchInto(const char* database_path, const char* pairs_path, int num_threads) {
  ColmapDatabase database = ColmapDatabase::Open(database_path, ColmapDatabase::Access::kReadWrite);
  std::vector<uint32_t> image_ids;
  std::map<std::string, uint32_t> place;
  for (const DatabaseImage& image : database.ReadImages()) {
    place[image.name] = static_cast<uint32_t>(image_ids.size());
    image_ids.push_back(image.image_id);
  }
  std::vector<ImagePair> pairs;
  std::ifstream stream(pairs_path);
  for (std::string name1, name2; stream >> name1 >> name2;) {
    const uint32_t a = place.at(name1);
    const uint32_t b = place.at(name2);
    pairs.push_back({std::min(a, b), std::max(a, b)});
  }
  MatchImagesOptions options;
  options.num_threads = num_threads;
  Reporter silent;
  const double start = SteadySeconds();
  const MatchImagesSummary summary = MatchImages(image_ids, pairs, options, &database, silent);
  std::printf("%zu pairs matched, %zu there already, %zu matches, %zu image loads, %.2f s\n",
              summary.num_pairs_matched, summary.num_pairs_skipped, summary.num_matches,
              summary.num_image_loads, SteadySeconds() - start);
  return EXIT_SUCCESS;
}

int Agreement(const char* path1, const char* path2) {
  const ColmapDatabase database1 = ColmapDatabase::Open(path1, ColmapDatabase::Access::kReadOnly);
  const ColmapDatabase database2 = ColmapDatabase::Open(path2, ColmapDatabase::Access::kReadOnly);
  size_t num1 = 0;
  size_t num2 = 0;
  size_t num_both = 0;
  size_t num_pairs = 0;
  std::vector<double> jaccard;
  database1.ForEachMatches([&](uint32_t id1, uint32_t id2, const FeatureMatches& matches1) {
    if (!database2.HasMatches(id1, id2)) return;
    std::set<std::pair<uint32_t, uint32_t>> set1;
    for (const FeatureMatch& match : matches1) set1.emplace(match.point2D_idx1, match.point2D_idx2);
    const FeatureMatches matches2 = database2.ReadMatches(id1, id2);
    size_t both = 0;
    for (const FeatureMatch& match : matches2) both += set1.count({match.point2D_idx1, match.point2D_idx2});
    const size_t either = set1.size() + matches2.size() - both;
    jaccard.push_back(either == 0 ? 1.0 : static_cast<double>(both) / static_cast<double>(either));
    num1 += set1.size();
    num2 += matches2.size();
    num_both += both;
    ++num_pairs;
  });
  if (num_pairs == 0) {
    std::printf("no common pairs\n");
    return EXIT_FAILURE;
  }
  std::printf(
      "%zu pairs: %zu and %zu matches, %zu in both; Jaccard %.4f over all, median of pairs %.4f, least "
      "%.4f\n",
      num_pairs, num1, num2, num_both,
      static_cast<double>(num_both) / static_cast<double>(num1 + num2 - num_both), Median(jaccard),
      *std::min_element(jaccard.begin(), jaccard.end()));
  return EXIT_SUCCESS;
}

}  // namespace
}  // namespace s2gs

int main(int argc, char** argv) {
  try {
    if (argc == 4 && std::strcmp(argv[1], "--agreement") == 0) return s2gs::Agreement(argv[2], argv[3]);
    if ((argc == 4 || argc == 5) && std::strcmp(argv[1], "--match") == 0) {
      return s2gs::MatchInto(argv[2], argv[3], argc == 5 ? std::atoi(argv[4]) : 0);
    }
    if (argc == 3 || argc == 4) return s2gs::Time(argv[1], argv[2], argc == 4 ? std::atoi(argv[3]) : 0);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return EXIT_FAILURE;
  }
  std::fprintf(stderr,
               "usage: match_bench [--match] DATABASE PAIRS [THREADS] | --agreement DATABASE1 DATABASE2\n");
  return EXIT_FAILURE;
}
