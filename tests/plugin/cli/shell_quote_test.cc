#include "plugin/cli/shell_quote.h"

#include <gtest/gtest.h>

#include <array>
#include <cstdio>
#include <string>
#include <vector>

namespace s2gs {
namespace {

// What a shell makes of the line: its words, each ended by a zero.
std::string WordsByShell(const std::string& line) {
  std::FILE* pipe = ::popen(("printf '%s\\0' " + line).c_str(), "r");
  std::string words;
  std::array<char, 4096> buffer{};
  for (size_t size = 0; (size = std::fread(buffer.data(), 1, buffer.size(), pipe)) > 0;) {
    words.append(buffer.data(), size);
  }
  ::pclose(pipe);
  return words;
}

TEST(ShellQuoted, AShellReadsTheSameWords) {
  const std::vector<std::string> words = {
      "s2gs", "--image_path", "/a/b c/it's", "", "$HOME", "a\"b", "*", "a;b", "~", "x\ny", "\\", "50%", "ä"};
  std::string expected;
  for (const std::string& word : words) expected += word + std::string(1, '\0');
  EXPECT_EQ(WordsByShell(ShellQuoted(words)), expected);
  EXPECT_EQ(ShellQuoted({"s2gs", "--a", "b/c.d"}), "s2gs --a b/c.d");
}

TEST(ShellWords, AreThoseOfAShell) {
  for (const std::string line : {"a  b\tc", "--x 'my masks' --y \"a b\"", "a\\ b \\\\", "'' \"\"",
                                 "a'b c'd\"e f\"", "\"a\\\"b\" 'c\\d'", "--k=v,w x;y"}) {
    const auto words = ShellWords(line);
    ASSERT_TRUE(words.has_value()) << line;
    std::string all;
    for (const std::string& word : *words) all += word + std::string(1, '\0');
    // Nothing but words: a shell would end the command at the semicolon.
    std::string quoted = line;
    if (const size_t at = quoted.find(';'); at != std::string::npos) quoted.insert(at, "\\");
    EXPECT_EQ(all, WordsByShell(quoted)) << line;
  }
  EXPECT_TRUE(ShellWords("")->empty());
  EXPECT_FALSE(ShellWords("a 'b").has_value());
  EXPECT_FALSE(ShellWords("a \"b'").has_value());
}

}  // namespace
}  // namespace s2gs
