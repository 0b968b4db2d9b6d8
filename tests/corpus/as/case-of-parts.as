; A sorter: the first VALUE that fits counts, ANY takes the rest, without ANY nothing happens.
; after: bin[1] = 10
; after: bin[2] = 20
; after: bin[3] = 20
; after: bin[4] = 30
; after: bin[9] = 99
; after: silent = 7
.PROGRAM main()
  FOR .part=1 TO 9
    CASE .part OF
    VALUE 1:
      bin[.part]=10
    VALUE 2,3:
      bin[.part]=20
    VALUE 3+1:
      bin[.part]=30
    VALUE 4:
      bin[.part]=31
    ANY :
      bin[.part]=99
    END
  END
  silent=7
  CASE silent OF
  VALUE 8:
    silent=8
  END
.END
