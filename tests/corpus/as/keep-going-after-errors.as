; ONE: a program that is called for an error; RETURNE goes on behind the step that failed.
; after: repaired = 3
; after: code = -30108
; after: $text = "(E0108)Division by zero"
; after: end.reached = 1
; stops: E0108 main 3
; stops: E0102 main 4
; stops: E0108 main 5
.PROGRAM main()
  repaired=0
  ONE repair
  x=1/0
  y=nobody+1
  x=1 MOD 0
  end.reached=1
.END
.PROGRAM repair()
  repaired=repaired+1
  code=ERROR
  $text=$ERROR(code)
  RETURNE
.END
