#include "sfm_split/split/pair_rings.h"

#include <algorithm>
#include <cstddef>

namespace s2gs {

int LargestRing(int count, const std::vector<std::pair<int, int>>& pairs) {
  std::vector<std::vector<int>> next(static_cast<size_t>(count));
  for (const auto& [a, b] : pairs) {
    if (a == b) continue;
    next[static_cast<size_t>(a)].push_back(b);
    next[static_cast<size_t>(b)].push_back(a);
  }
  for (std::vector<int>& others : next) {
    std::sort(others.begin(), others.end());
    others.erase(std::unique(others.begin(), others.end()), others.end());
  }
  // Depth first: photos stay on `open` until the pair to their parent is known to be the only way back.
  struct Step {
    int photo;
    int parent;
    size_t at;  // among the photo's neighbours
  };
  std::vector<int> number(static_cast<size_t>(count), -1);  // in the order in which photos are met
  std::vector<int> lowest(static_cast<size_t>(count), 0);   // that the photo's branch leads back to
  std::vector<int> open;
  std::vector<Step> path;
  int met = 0;
  int largest = 0;
  const auto meet = [&](int photo, int parent) {
    number[static_cast<size_t>(photo)] = lowest[static_cast<size_t>(photo)] = met++;
    open.push_back(photo);
    path.push_back({photo, parent, 0});
  };
  for (int start = 0; start < count; ++start) {
    if (number[static_cast<size_t>(start)] >= 0) continue;
    meet(start, -1);
    while (!path.empty()) {
      Step& step = path.back();
      const auto photo = static_cast<size_t>(step.photo);
      if (step.at < next[photo].size()) {
        const int other = next[photo][step.at++];
        if (other == step.parent) continue;
        if (number[static_cast<size_t>(other)] < 0) {
          meet(other, step.photo);
        } else {
          lowest[photo] = std::min(lowest[photo], number[static_cast<size_t>(other)]);
        }
        continue;
      }
      const int parent = step.parent;
      path.pop_back();
      if (parent >= 0) {
        int& of_parent = lowest[static_cast<size_t>(parent)];
        of_parent = std::min(of_parent, lowest[photo]);
      }
      if (lowest[photo] != number[photo]) continue;
      int size = 0;
      for (int last = -1; last != static_cast<int>(photo); open.pop_back()) {
        last = open.back();
        ++size;
      }
      largest = std::max(largest, size);
    }
  }
  return largest;
}

}  // namespace s2gs
