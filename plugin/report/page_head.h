#pragma once

#include <string>

#include "plugin/report/html_writer.h"

namespace s2gs {

/// Opens a page that needs nothing besides and fetches nothing, in the style of all: its head and, in its
/// body, what kind of page it is above its title. The elements html, body and header are left open.
void OpenPage(const std::string& title, const std::string& kind, HtmlWriter* out);

}  // namespace s2gs
