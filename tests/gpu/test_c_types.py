"""C types are found as cffi finds them, and with fewer lines."""

from cffi import FFI

from gpusim.gpu.c_types import parse_few

DECLARED = """
typedef struct { int x; } Point;
typedef Point Alias;
typedef unsigned int Flags;
"""
NAMED = ("Alias *", "Point[]", "Flags", "void(*)(Point *, Flags)", "uint8_t []", "char *")


def test_types_are_those_that_cffi_finds():
    plain, quick = FFI(), FFI()
    for ffi in (plain, quick):
        ffi.cdef(DECLARED)
    parse_few(quick)
    for name in NAMED:
        assert repr(quick.getctype(name)) == repr(plain.getctype(name))
    assert quick.new("Alias *").x == 0


def test_only_types_that_are_named_are_parsed():
    ffi = FFI()
    ffi.cdef(DECLARED)
    seen = []
    parse = ffi._parser._parse

    def watched(source):
        seen.append(set(ffi._parser._declarations))
        return parse(source)

    ffi._parser._parse = watched
    parse_few(ffi)
    ffi.typeof("Alias *")
    assert seen == [{"typedef Alias"}]
    assert "typedef Flags" in ffi._parser._declarations


def test_a_parser_that_is_not_known_stays_as_it_is():
    class Other:
        pass

    parse_few(Other())
    other = Other()
    other._parser = Other()
    parse_few(other)
    assert not vars(other._parser)
