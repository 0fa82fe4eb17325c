#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

namespace s2gs {

// Which pairs of images to match, in rounds, instead of all n (n - 1) / 2: neighbours in capture order
// (NeighbourPairs) or, for photos without order, the most similar ones by a cheap global similarity
// (SimilarPairs); for the background, one image of each station against those of others
// (RepresentativePairs). Each round needs what the geometry of the earlier ones told. Images are numbered 0
// .. n - 1. Lists of pairs are sorted and without repetition, and their lengths grow as n, not as its square,
// with every limit fixed.

/// Two images, first < second.
struct ImagePair {
  uint32_t first = 0;
  uint32_t second = 0;

  friend bool operator==(ImagePair a, ImagePair b) { return a.first == b.first && a.second == b.second; }
  friend bool operator<(ImagePair a, ImagePair b) {
    return a.first != b.first ? a.first < b.first : a.second < b.second;
  }
};

/// Sorted, without repetition, without the pairs in `done`.
std::vector<ImagePair> NewPairs(std::vector<ImagePair> pairs, const std::vector<ImagePair>& done);

/// Number of matches of every pair of images, by a cheap matching; symmetric, n x n, the diagonal is ignored.
using SimilarityMatrix = Eigen::Matrix<uint32_t, Eigen::Dynamic, Eigen::Dynamic>;

/// The images by name as people number them: runs of digits compare as numbers, so "img2" < "img10".
std::vector<uint32_t> NaturalNameOrder(const std::vector<std::string>& names);

/// How well an order agrees with a similarity: over all images, the mean share of the other images that are
/// less similar than the more similar of the two neighbours in the order (ties count half). 1: every image's
/// neighbour is its most similar one; 2/3: expected of a random order. 1 for fewer than three images.
double OrderAgreement(const std::vector<uint32_t>& order, const SimilarityMatrix& similarity);

/// Above this agreement, an order is taken for the order of capture.
inline constexpr double kMinOrderAgreement = 0.85;

/// Every image with the next `window` images of the order.
/// \param wrap  also from the end of the order to its beginning: the last step of a full turn lies next to
///              the first.
std::vector<ImagePair> NeighbourPairs(const std::vector<uint32_t>& order, int window, bool wrap);

/// Every image with the `num_partners` most similar others, and the best pairs that connect what these leave
/// apart. Pairs of similarity 0 never.
std::vector<ImagePair> SimilarPairs(const SimilarityMatrix& similarity, int num_partners);

/// Of every station the image with the most features; among equals the lowest. By ascending station.
/// \param station  per image: its station, or negative for none.
std::vector<uint32_t> StationRepresentatives(const std::vector<int>& station,
                                             const std::vector<uint32_t>& num_features);

/// All pairs of representatives while there are at most max_partners + 1. Beyond that each with those 1, 2,
/// 4, 8, ... places further on in the list, at most max_partners.
std::vector<ImagePair> RepresentativePairs(const std::vector<uint32_t>& representatives, int max_partners);

}  // namespace s2gs
