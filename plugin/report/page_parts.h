#pragma once

namespace s2gs {

// The files of page/, which the build compiles into the program: the page's style, what its buttons and
// sliders do, and the viewer of the mesh (WebGL, no library).
extern const char* const kPageStyle;
extern const char* const kPageScript;
extern const char* const kViewerScript;

}  // namespace s2gs
