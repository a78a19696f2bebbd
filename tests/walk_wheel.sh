#!/usr/bin/env bash
# The start of the documentation by the wheel: an environment of its own, an empty folder, no
# repository. `tests/walk_wheel.sh [EXTRAS] [PYTHON]`, as in `tests/walk_wheel.sh all python3.13`.
set -euo pipefail
extras=${1:-} python=${2:-python3}
root=$(cd "$(dirname "$0")/.." && pwd)
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
unset PYTHONPATH
export OMP_NUM_THREADS=1
"$python" -m venv "$place/env"
"$place/env/bin/python" -m pip wheel --quiet --no-deps --wheel-dir "$place" "$root"
wheel=$(echo "$place"/foldlab-*.whl)
start=$SECONDS
"$place/env/bin/python" -m pip install --quiet "$wheel${extras:+[$extras]}"
echo "installed in $((SECONDS - start)) s: $(du -sm "$place/env" | cut -f1) MB"
mkdir "$place/empty" && cd "$place/empty"
PATH="$place/env/bin:$PATH"
unit="--passive PET --active SMP --set l_s=40mm --set b_s=10mm --set h_s=0.1mm --set h_i=0.2mm
  --set l_i=10mm --set contraction=20%"
walk() { echo "+ foldlab $*" && foldlab "$@" > said.txt 2>&1 || { cat said.txt; exit 1; }; }
python -c "import foldlab, sys; assert foldlab.__file__.startswith(sys.prefix)"
walk sample --space reduced -n 300 --seed 1 -o designs.parquet
walk label designs.parquet -o labels.db --source timoshenko
walk export labels.db -o labels.parquet
walk train labels.parquet --model tree -o model
walk score model labels.parquet
walk predict designs.parquet --model model -o predicted.csv
walk map model -o map.png
walk materials
walk check $unit
walk design --passive PET --active SMP --set l_s=40mm --set b_s=10mm --want angle=90deg -n 1
walk experiment
if [[ $extras == *all* ]]; then
  walk train labels.parquet --model network --set epochs=100 -o network --track
  walk experiment regime_maps --tiny
  walk structure cube --passive PET --active SMP --set h_s=0.1mm --set h_i=0.2mm --set l_i=5mm \
    --set E_i=20MPa --set contraction=23% --need 85deg
fi
foldlab --help > /dev/null
python - <<'END'
import os, subprocess, sys, time
for words in (["-c", "import foldlab"], ["-c", "from foldlab.cli import main; main()", "--help"]):
    before, start = os.times(), time.perf_counter()
    subprocess.run([sys.executable, *words], stdout=subprocess.DEVNULL, check=True)
    after, bare = os.times(), time.perf_counter() - start
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    print(f"{words[1][:20]!r} {' '.join(words[2:])}: {cpu:.2f} CPU-s, {bare:.2f} s")
END
