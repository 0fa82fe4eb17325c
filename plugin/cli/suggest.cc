#include "plugin/cli/suggest.h"

#include <algorithm>
#include <cctype>
#include <utility>

namespace s2gs {
namespace {

std::string Normalised(std::string_view word) {
  std::string result(word);
  for (char& c : result) c = c == '-' ? '_' : static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return result;
}

}  // namespace

int EditDistance(std::string_view a, std::string_view b) {
  // Three rows of the table of distances between the beginnings of both words.
  std::vector<int> before(b.size() + 1);
  std::vector<int> last(b.size() + 1);
  std::vector<int> row(b.size() + 1);
  for (size_t j = 0; j <= b.size(); ++j) last[j] = static_cast<int>(j);
  for (size_t i = 1; i <= a.size(); ++i) {
    row[0] = static_cast<int>(i);
    for (size_t j = 1; j <= b.size(); ++j) {
      const int replace = last[j - 1] + (a[i - 1] == b[j - 1] ? 0 : 1);
      row[j] = std::min({replace, last[j] + 1, row[j - 1] + 1});
      if (i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1]) {
        row[j] = std::min(row[j], before[j - 2] + 1);
      }
    }
    std::swap(before, last);
    std::swap(last, row);
  }
  return last[b.size()];
}

std::vector<std::string> NearestWords(std::string_view word, const std::vector<std::string>& candidates,
                                      size_t max_count) {
  // A whole command line pasted into one argument is no misspelling, and its distances take long.
  constexpr size_t kMaxWordLength = 200;
  if (word.empty() || word.size() > kMaxWordLength) return {};
  const std::string wanted = Normalised(word);
  std::vector<std::pair<int, std::string>> found;
  for (const std::string& candidate : candidates) {
    const std::string normalised = Normalised(candidate);
    int distance = EditDistance(wanted, normalised);
    const bool is_beginning = wanted.size() >= 3 && normalised.compare(0, wanted.size(), wanted) == 0;
    if (is_beginning) distance = std::min(distance, 1);
    const int near_enough =
        std::max<int>(1, static_cast<int>(std::min(wanted.size(), normalised.size())) / 3);
    if (distance <= near_enough) found.emplace_back(distance, candidate);
  }
  std::sort(found.begin(), found.end());
  // Only what is about as near as the best: more would blur the answer.
  std::vector<std::string> result;
  for (const auto& [distance, candidate] : found) {
    if (result.size() == max_count || distance > found.front().first + 1) break;
    result.push_back(candidate);
  }
  return result;
}

}  // namespace s2gs
