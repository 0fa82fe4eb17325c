#include "mesh/fusion/tsdf_integrate.h"

namespace s2gs {

std::unique_ptr<TsdfIntegrator> MakeCudaIntegrator(TsdfVolume* /*volume*/) { return nullptr; }

}  // namespace s2gs
