#pragma once

#include <string>
#include <vector>

namespace s2gs {

/// Names of images that no reader may let through.
inline std::vector<std::string> HostileNames() {
  return {"",
          "/etc/passwd",
          "//a.jpg",
          "..",
          "../photos/a.jpg",
          "sub/../../a.jpg",
          "sub/..",
          ".",
          "./a.jpg",
          "sub//a.jpg",
          "sub/",
          "a\\b.jpg",
          "..\\a.jpg",
          "a\nb.jpg",
          "a\tb.jpg",
          "\x1b[2Ja.jpg",
          "a\x7f.jpg",
          "a\xC2\x9B.jpg",
          " a.jpg",
          "a.jpg ",
          "\xFF\xFE.jpg",
          "\xC0\xAE\xC0\xAE/a.jpg",
          std::string(241, 'a'),
          std::string("sub/") + std::string(300, 'b') + "/a.jpg",
          [] {
            std::string deep;
            for (int i = 0; i < 600; ++i) deep += "d/";
            return deep + "a.jpg";
          }()};
}

}  // namespace s2gs
