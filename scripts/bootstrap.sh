# Sourced by mpirun.sh and run-tests.sh: makes .venv beside them if it is missing or out of date, and activates it.
# Usage: bootstrap EXTRAS   (a comma-separated list of the extras of pyproject.toml)
bootstrap() {
  local extras=$1 root venv stamp python
  root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
  venv=${CALCIDEM_VENV:-$root/.venv}
  # A change of the dependencies makes a new stamp, so an old environment is brought up to date by itself.
  stamp=$venv/.calcidem-$extras-$(cksum <"$root/pyproject.toml" | cut -d' ' -f1)
  if [ ! -e "$stamp" ]; then
    python=$(command -v "${PYTHON:-python3}" || true)
    if [ -z "$python" ] || ! "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then
      echo "calcidem needs Python 3.11 or newer; set PYTHON to the path of one (found: ${python:-none})." >&2
      return 2
    fi
    echo "Installing calcidem into $venv (once)."
    [ -x "$venv/bin/python" ] || "$python" -m venv "$venv"
    # The pip of Python 3.11 takes twice the time of a newer one. If there is no newer one, the old one installs.
    "$venv/bin/python" -m pip install --no-compile --quiet --disable-pip-version-check --upgrade pip || true
    # Python compiles a module when it is first imported; most modules of the libraries never are.
    "$venv/bin/python" -m pip install --no-compile --quiet --disable-pip-version-check -e "$root[$extras]"
    touch "$stamp"
  fi
  # shellcheck disable=SC1091
  . "$venv/bin/activate"
}
