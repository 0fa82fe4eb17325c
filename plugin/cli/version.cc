#include "plugin/cli/version.h"

namespace s2gs {

std::string Version() { return S2GS_VERSION; }

}  // namespace s2gs
