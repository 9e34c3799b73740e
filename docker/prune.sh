#!/bin/sh
# Take from an environment what no program of boxlift's loads, and compile the rest.
# Usage: prune.sh ENVIRONMENT
set -eu
python=$1/bin/python
packages=$("$python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
cd "$packages"

# Headers and test programs of torch. torch_shm_manager stays: torch asks for it when it loads.
rm -rf torch/include torch/test
find torch/bin -mindepth 1 ! -name torch_shm_manager -delete
# Open3D's window: fonts, shaders, examples; and its operators for TensorFlow.
rm -rf open3d/examples open3d/resources open3d/open3d_tf_ops.so
# Compiled here, since the root file system is read-only later; never compared with the source again.
"$python" -m compileall -q -j 0 --invalidation-mode unchecked-hash . >/dev/null || true  # templates are no Python
