#include "plugin/colmap/mapping_attempts.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <string>

#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

std::string Example() { return ToJson({{"default", 2, 41, 12.5}, {"tolerant", 0, 0, 0}}).dump(1) + "\n"; }

TEST(MappingAttempts, ComeBackAsTheyWere) {
  const std::vector<MappingAttempt> attempts = ParseMappingAttempts(Example(), "attempts.json");
  ASSERT_EQ(attempts.size(), 2U);
  EXPECT_EQ(attempts[0].settings, "default");
  EXPECT_EQ(attempts[0].models, 2);
  EXPECT_EQ(attempts[0].images, 41);
  EXPECT_EQ(attempts[0].seconds, 12.5);
  EXPECT_EQ(ToJson(attempts).dump(1) + "\n", Example());
  EXPECT_TRUE(ParseMappingAttempts("[]", "attempts.json").empty());
}

TEST(MappingAttemptsBadInput, EveryDamage) {
  ForEachDamage(Example(), [](const std::string& damaged, const std::string& description) {
    ExpectOkOrUserError([&] { ParseMappingAttempts(damaged, "split/attempts.json"); }, "split/attempts.json",
                        description);
  });
}

TEST(MappingAttemptsBadInput, SaysWhatIsWrongAndWhatToDo) {
  const std::string good = R"({"settings":"a","models":1,"images":1,"seconds":1})";
  for (const char* bad : {"", "{}", "3", "[3]", "[{}]", "[[]]", R"([{"settings":"a","models":1,"images":1}])",
                          R"([{"settings":1,"models":1,"images":1,"seconds":1}])",
                          R"([{"settings":"a","models":-1,"images":1,"seconds":1}])",
                          R"([{"settings":"a","models":1.5,"images":1,"seconds":1}])",
                          R"([{"settings":"a","models":1,"images":99999999999,"seconds":1}])",
                          R"([{"settings":"a","models":1,"images":1,"seconds":-1}])",
                          R"([{"settings":"a","models":1,"images":1,"seconds":1e999}])",
                          R"([{"settings":"a","models":1,"images":1,"seconds":null}])"}) {
    ExpectUserError([&] { ParseMappingAttempts(bad, "split/attempts.json"); },
                    {"split/attempts.json", "damaged", "Delete it"}, bad);
  }
  EXPECT_EQ(ParseMappingAttempts("[" + good + "]", "a").size(), 1U);
  const TemporaryFolder folder;
  ExpectUserError([&] { ReadMappingAttempts(folder / "attempts.json"); }, {"attempts.json", "Delete it"});
}

}  // namespace
}  // namespace s2gs
