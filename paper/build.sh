#!/bin/sh
# paper/paper.md to PDF, without a network: pip install pypandoc_binary typst (Pandoc 3.1.2 or newer with its Typst writer,
# and Typst, which sets mathematics and needs no LaTeX). Usage: paper/build.sh [OUT.pdf], by default paper/paper.pdf.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
out=${1:-$here/paper.pdf}
case $out in /*) ;; *) out=$PWD/$out ;; esac
cd "$here"
python -P numbers.py --check
python -P render.py "$out"
echo "$out"
