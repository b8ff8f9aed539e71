"""One file per board; :mod:`boards.board` has what they share, :mod:`boards.catalogue` lists them."""
