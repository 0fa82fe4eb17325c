#pragma once

#include <filesystem>
#include <string>

namespace s2gs {

/// Whether a file ends before what its own header says that it holds: the strips and tiles of a TIFF's
/// pictures and of raw files that are laid out like one (DNG, NEF, CR2, ARW, PEF, ORF, RW2), the parts of a
/// RAF, the boxes of HEIC, AVIF and CR3, the lengths of WebP and BMP. Decoders fill what is missing with
/// black, some of them in silence. Looks at a few kilobytes; of other formats, and of headers that are
/// damaged, nothing is said. Throws UserError when the file cannot be opened.
bool EndsTooEarly(const std::filesystem::path& path);

}  // namespace s2gs
