#include "plugin/report/page_head.h"

#include <cctype>

#include "plugin/report/page_parts.h"

namespace s2gs {

void OpenPage(const std::string& title, const std::string& kind, HtmlWriter* out) {
  std::string small = kind;
  if (!small.empty()) small[0] = static_cast<char>(std::tolower(static_cast<unsigned char>(small[0])));
  out->Append("<!DOCTYPE html>\n");
  out->Open("html", {{"lang", "en"}}).Open("head");
  out->Void("meta", {{"charset", "utf-8"}});
  out->Void("meta", {{"name", "viewport"}, {"content", "width=device-width, initial-scale=1"}});
  // The page may not fetch anything, whatever stands in it.
  out->Void("meta",
            {{"http-equiv", "Content-Security-Policy"},
             {"content",
              "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"}});
  out->Void("meta", {{"name", "color-scheme"}, {"content", "light dark"}});
  out->Element("title", title + ": " + small);
  out->Open("style").Append(kPageStyle).Close();
  out->Close().Open("body");
  out->Open("header").Open("div").Element("span", kind).Element("h1", title).Close();
}

}  // namespace s2gs
