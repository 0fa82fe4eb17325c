#pragma once

#include <cstdint>
#include <vector>

#include "s2gs/core/pinhole_view.h"
#include "s2gs/image/image_file.h"

namespace s2gs {

/// A camera that has only turned, as on a tripod that was knocked, turned back to how another looks: the view
/// from its own place.
PinholeView TurnedTo(const PinholeView& other, const PinholeView& view);

/// The picture of `view` as `turned` sees it, which stands in the same place and has its size. Where `view`
/// does not see it, the picture is left as it is. \param picture  RGB, of the views' size.
/// \param is_outside  by pixel, 1 where `view` does not see it; may be null.
Image8 TurnedPicture(const PinholeView& view, const PinholeView& turned, const Image8& picture,
                     std::vector<uint8_t>* is_outside);

}  // namespace s2gs
