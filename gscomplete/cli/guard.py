"""Run a command so that nothing reaches the user as a traceback.

Conventions
-----------
* Exit codes: 0 or the command's own; 2 user error; 4 out of memory; 70 internal error; 130
  interrupted by Ctrl-C; 129 and 143 stopped by SIGHUP and SIGTERM; 141 the reader of the output is
  gone.
* A signal that arrives while a library is being imported ends the process at once, since there is
  no work to save: PyTorch aborts if its import is interrupted, and other libraries swallow the
  interrupt and leave a half-loaded module.
* Libraries may turn an interrupt into an error of their own (such as a SystemError of a C
  extension), so an unexpected error after a signal is treated as that signal.
* Shared by the packages' console commands.
"""

from __future__ import annotations

import atexit
import codecs
import contextlib
import ctypes
import gc
import io
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from types import FrameType
from typing import Any, NoReturn

from gscomplete import __version__
from gscomplete.errors import UserError
from gscomplete.util.parse import shown_text

DEBUG_VARIABLE = "GSCOMPLETE_DEBUG"
"""Set to anything, an unexpected error ends in its traceback."""
_ALLOCATOR = "DefaultCPUAllocator: can't allocate memory"
"""What PyTorch's RuntimeError says where Python would raise a MemoryError."""
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of glibc's malloc.h
_KEPT_BYTES = 2**30
_LARGEST_OF_OLD_GLIBC = 2**25
_OBJECTS_BETWEEN_COLLECTIONS = 100_000

how_to_go_on: ContextVar[str] = ContextVar("how_to_go_on")
"""What the running command tells after an interrupt; it may change that as it goes on."""


def read_options(
    command: Any,
    arguments: Sequence[str],
    *,
    prog: str,
    description: str,
    config: Sequence[Any] = (),
) -> Any:
    """Read the words of a command line into the options of one of its commands.

    Args:
        command: union of the classes of options.
        arguments: words of the command line.
        prog: what the program is called.
        description: what it does.
        config: tyro's markers.
    """
    import tyro

    with _joined_help():
        return tyro.cli(
            command, prog=prog, description=description, args=arguments, config=tuple(config)
        )


@contextlib.contextmanager
def _joined_help() -> Iterator[None]:
    """Have help texts of several lines wrapped as one.

    The parser of docstrings keeps the indentation of their lines, and tyro takes indented lines for
    those of a list.
    """
    import docstring_parser

    parse = docstring_parser.parse_from_object

    def joined(owner: object) -> Any:
        found = parse(owner)
        for option in found.params:
            if option.description is not None:
                option.description = " ".join(option.description.split())
        return found

    docstring_parser.parse_from_object = joined  # type: ignore[assignment]
    try:
        yield
    finally:
        docstring_parser.parse_from_object = parse


class Stopped(KeyboardInterrupt):
    """A signal asked the process to end; jobs write a checkpoint, as after Ctrl-C."""

    def __init__(self, number: int) -> None:
        """Name the signal."""
        super().__init__(signal.Signals(number).name)
        self.number = number


def let_threads_sleep() -> None:
    """Keep waiting threads from spinning long; call before anything loads the OpenMP runtime.

    PyTorch and Numba each keep a pool, and a pool that spins takes the cores from the other and
    from other programs. The demo's completion on two idle cores, and beside two busy processes,
    takes 3.9 and 17.5 s as the runtime is by itself, 4.2 and 7.9 s without any spinning, and 3.6
    and 7.2 s with so short a one.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    os.environ.setdefault("GOMP_SPINCOUNT", "3000")


def keep_freed_memory() -> None:
    """Have glibc keep freed memory for the next request; call before large arrays are made.

    By default glibc returns each large array to the system and requests it again, and the system
    then clears it page by page: a fifth of the time of drawing splats. Other allocators are left
    unchanged.
    """
    with contextlib.suppress(AttributeError, OSError, TypeError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)
        if not mallopt(_M_MMAP_THRESHOLD, _KEPT_BYTES):
            mallopt(_M_MMAP_THRESHOLD, _LARGEST_OF_OLD_GLIBC)


def print_version(program: str) -> int:
    """Print the version of a console command; return the exit code."""

    def tell() -> int:
        sys.stdout.write(f"{program} {__version__}\n")
        return 0

    return run_guarded(program, tell, "nothing was done")


def run_process(main: Callable[[], int]) -> NoReturn:
    """Run a console command as all that its process does, and end the process.

    While PyTorch loads, Python's garbage collector would run again and again, and at the end Python
    would tear down all modules. Together these take a second of every command; here the collector
    runs rarely, and the operating system frees the memory.

    Args:
        main: runs the command and returns its exit code.
    """
    gc.set_threshold(_OBJECTS_BETWEEN_COLLECTIONS)
    _open_closed_streams()
    _have_all_characters_written()
    code = main()
    others = set(threading.enumerate()) - {threading.main_thread()}
    if not all(thread.daemon for thread in others):  # Python knows what to wait for
        sys.exit(code)
    atexit._run_exitfuncs()
    with contextlib.suppress(OSError, ValueError):
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)


def run_guarded(program: str, command: Callable[[], int], interrupted: str) -> int:
    """Call ``command`` and return its exit code; print errors as one line.

    Args:
        program: the console command's name, which starts every message.
        command: the body.
        interrupted: message after Ctrl-C, unless the command changes ``how_to_go_on``.
    """
    before = how_to_go_on.set(interrupted)
    try:
        return _guarded(program, command)
    finally:
        how_to_go_on.reset(before)


def _guarded(program: str, command: Callable[[], int]) -> int:
    """Call ``command`` as ``run_guarded`` does."""

    def say(message: str) -> None:
        with contextlib.suppress(OSError):  # the terminal may be gone
            sys.stderr.write(f"{program}: {shown_text(message)}\n")

    received: list[KeyboardInterrupt] = []
    try:
        with _signals_raise(program, received):
            code = command()
        sys.stdout.flush()  # what is buffered may find its reader gone only now
        return code
    except UserError as error:
        say(f"error: {error}")
        return error.exit_code
    except KeyboardInterrupt as stop:
        say(_told(stop))
        return _exit_code(stop)
    except BrokenPipeError:
        _forget_stdout()
        return 141  # as with ``| head``
    except OSError as error:
        say(f"error: {error.filename or 'input or output'}: {error.strerror or error}")
        return UserError.exit_code
    except MemoryError:
        say("error: out of memory")
        return 4
    except Exception as error:
        if received:
            say(_told(received[0]))
            return _exit_code(received[0])
        if _ALLOCATOR in str(error):
            say("error: out of memory")
            return 4
        if os.environ.get(DEBUG_VARIABLE):
            raise
        say(
            f"internal error: {type(error).__name__}: {error}\n"
            f"Please report it with the traceback that {DEBUG_VARIABLE}=1 prints."
        )
        return 70


@contextlib.contextmanager
def _signals_raise(program: str, received: list[KeyboardInterrupt]) -> Iterator[None]:
    """Have SIGINT, SIGTERM and SIGHUP interrupt the block, but for those that are ignored.

    Args:
        program: the console command's name.
        received: the raised exceptions are appended to it.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, frame: FrameType | None) -> None:
        reason = KeyboardInterrupt() if number == signal.SIGINT else Stopped(number)
        if not _is_importing(frame):
            received.append(reason)
            raise reason
        with contextlib.suppress(OSError, RuntimeError, ValueError):
            sys.stdout.flush()
        with contextlib.suppress(OSError):
            os.write(2, f"{program}: {_told(reason)}\n".encode())
        os._exit(_exit_code(reason))

    names = [name for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    numbers = [getattr(signal, name) for name in names]
    before = {number: signal.getsignal(number) for number in numbers}
    for number, handler in before.items():
        if handler != signal.SIG_IGN:  # as with nohup
            signal.signal(number, stop)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _is_importing(frame: FrameType | None) -> bool:
    """Tell whether an import is under way in a frame or in those that called it."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _told(stop: KeyboardInterrupt) -> str:
    """Return the message about an interrupt."""
    name = f"stopped by {stop}" if isinstance(stop, Stopped) else "interrupted"
    return f"{name}; {how_to_go_on.get()}"


def _exit_code(stop: KeyboardInterrupt) -> int:
    """Return the exit code after an interrupt."""
    return 128 + (stop.number if isinstance(stop, Stopped) else signal.SIGINT)


def _open_closed_streams() -> None:
    """Have closed standard streams read nothing and discard what is written, as daemons need it.

    The system gives the next opened file the number of a closed stream, and what a library prints
    would go into that file.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # takes the lowest free number
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            mode = "w" if number else "r"
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115


def _have_all_characters_written() -> None:
    """Have standard output and error write the code of what their encoding lacks.

    Bytes of file names that are no text are written as they are.
    """

    def replaced(error: UnicodeError) -> tuple[str | bytes, int]:
        try:
            return codecs.lookup_error("surrogateescape")(error)
        except UnicodeError:
            return codecs.backslashreplace_errors(error)

    codecs.register_error("gscomplete", replaced)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="gscomplete")


def _forget_stdout() -> None:
    """Discard buffered output, which Python would otherwise try to write at exit, with an error."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
