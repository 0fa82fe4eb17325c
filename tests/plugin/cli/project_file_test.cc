#include "plugin/cli/project_file.h"

#include <gtest/gtest.h>

#include <string>

#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

std::string Flat(const std::vector<ProjectFileEntry>& entries) {
  std::string text;
  for (const auto& [name, value, line] : entries)
    text += std::to_string(line) + ":" + name + "=<" + value + ">\n";
  return text;
}

TEST(ProjectFile, ReadsKeysThenGroups) {
  const TemporaryFolder folder;
  WriteAll(folder / "a.ini",
           "\xEF\xBB\xBF# a comment\r\n"
           "workspace_path = /data/my scan \r\n"
           "; another\n"
           "\n"
           "quality=high\n"
           "quoted = \" spaces # kept \"\n"
           "empty=\n"
           "equals = a=b\n"
           "[Tsdf]\n"
           "  voxel_size\t=\t0.002\n"
           "[ Other ]\n"
           "last = 1");
  EXPECT_EQ(Flat(ReadProjectFile(folder / "a.ini")),
            "2:workspace_path=</data/my scan>\n"
            "5:quality=<high>\n"
            "6:quoted=< spaces # kept >\n"
            "7:empty=<>\n"
            "8:equals=<a=b>\n"
            "10:Tsdf.voxel_size=<0.002>\n"
            "12:Other.last=<1>\n");
}

TEST(ProjectFile, NamesFileAndLineOfFaults) {
  const TemporaryFolder folder;
  const std::string path = (folder / "a.ini").string();
  for (const std::string line :
       {"quality high", "= high", "[Tsdf", "[]", "[Ts df]", "qual ity = high", "]", "--quality x"}) {
    WriteAll(path, "a = 1\n" + line + "\nb = 2\n");
    ExpectUserError([&] { ReadProjectFile(path); }, {path, "line 2"}, line);
  }
  ExpectUserError([&] { ReadProjectFile(folder / "missing.ini"); },
                  {"missing.ini: no such file", "--project_path"});
}

TEST(ProjectFileBadInput, DamagedFiles) {
  const TemporaryFolder folder;
  const std::string path = (folder / "a.ini").string();
  ForEachDamage("a = 1\nb = \"x\"\n[Group]\nc = /some/path\n# end\n",
                [&](const std::string& damaged, const std::string& description) {
                  WriteAll(path, damaged);
                  const ScopedAllocationLimit limit(1 << 16);
                  ExpectOkOrUserError([&] { ReadProjectFile(path); }, path, description);
                });
}

TEST(ProjectFileBadInput, HugeFiles) {
  const TemporaryFolder folder;
  WriteAll(folder / "a.ini", std::string((1 << 20) + 1, '\n'));
  ExpectUserError([&] { ReadProjectFile(folder / "a.ini"); }, {"1048577 bytes"});
  WriteAll(folder / "b.ini", std::string(1 << 20, '['));
  ExpectUserError([&] { ReadProjectFile(folder / "b.ini"); }, {"line 1"});
}

}  // namespace
}  // namespace s2gs
