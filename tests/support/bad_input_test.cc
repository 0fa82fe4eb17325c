#include "tests/support/bad_input.h"

#include <gtest/gtest-spi.h>
#include <gtest/gtest.h>

#include <new>
#include <set>
#include <stdexcept>
#include <vector>

#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

TEST(BadInput, EveryTruncationAndBitFlipOnce) {
  std::set<std::string> seen;
  int calls = 0;
  ForEachDamage("ab", [&](const std::string& damaged, const std::string&) {
    seen.insert(damaged);
    ++calls;
  });
  EXPECT_EQ(calls, 2 + 16);
  EXPECT_EQ(seen.size(), 18u);
  EXPECT_EQ(seen.count("ab"), 0u);
  EXPECT_EQ(seen.count("a"), 1u);
  EXPECT_EQ(seen.count("`b"), 1u);
}

TEST(BadInput, WithIntegerIsLittleEndian) {
  EXPECT_EQ(WithInteger("xxxx", 1, 2, 0x4142), "xBAx");
  EXPECT_THROW(WithInteger("xx", 1, 2, 0), std::out_of_range);
}

TEST(BadInput, OnlyUserErrorsThatNameThePathPass) {
  EXPECT_TRUE(ExpectOkOrUserError([] {}, "a.bin"));
  EXPECT_FALSE(ExpectOkOrUserError([] { throw UserError("a.bin", "bad", ""); }, "a.bin"));
  EXPECT_NONFATAL_FAILURE(ExpectOkOrUserError([] { throw UserError("b.bin", "bad", ""); }, "a.bin"),
                          "does not name");
  EXPECT_NONFATAL_FAILURE(ExpectOkOrUserError([] { throw std::runtime_error("a.bin"); }, "a.bin"),
                          "not a UserError");
  EXPECT_NONFATAL_FAILURE(ExpectUserError([] {}, {"a.bin"}), "no error");
}

TEST(BadInput, AllocationsOverTheLimitFail) {
  const auto allocate = [](size_t count) { return std::vector<char>(count).size(); };
  {
    const ScopedAllocationLimit limit(1000);
    EXPECT_EQ(allocate(1000), 1000u);
  }
  const auto exceed = [&] {
    const ScopedAllocationLimit limit(1000);
    try {
      allocate(1001);
    } catch (const std::bad_alloc&) {
    }
  };
  EXPECT_NONFATAL_FAILURE(exceed(), "1001 bytes");
  EXPECT_EQ(allocate(2000), 2000u);
}

}  // namespace
}  // namespace s2gs
