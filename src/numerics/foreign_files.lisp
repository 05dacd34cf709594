;;; anmech: equations of motion as a file of C, Fortran, Julia or Python.
;;;
;;; A file has routines: the rates, their derivatives, the mass matrix, multipliers, invariants.  A routine is made of
;;; steps that no language knows:
;;;   (:local array rows columns)       a place; columns nil: a vector
;;;   (:fill array rows columns)        with zeros
;;;   (:compute program array-elements) elements are lists (array row column columns)
;;;   (:solve A X columns)              X becomes the solution of A x = X, for each column
;;;   (:copy element text)              (:copy-row array row from-array from-row columns)
;;;
;;; Equations A u = b are solved at every call, by elimination with exchange of rows.  Their derivatives by a state z
;;; are the solutions of  A u' = d(b - A u)/dz,  u as it is on the right.
;;;
;;; Entry points: anmech_check_language, anmech_code_file.

(in-package :anmech)
(needs "session/file_names" "session/scripts" "session/texts" "algebra/terms" "numerics/codegen" "numerics/dag"
       "numerics/differentiation" "numerics/foreign_code")

(defstruct routine name what output rows columns steps)

(defstruct equations
  "What a file is made of; jets and expressions are Maxima's.  RATES tells of each state what its rate is: the number of
a state, or minus that of an unknown, both from 1 on; nil where RIGHT holds the rates themselves."
  states time parameters unknowns rates matrix right mass invariants)

;;; Routines

(defun plain-variables (equations)
  (append (equations-states equations) (list (equations-time equations)) (equations-parameters equations)))

(defun elements (array rows &optional columns)
  (loop for i below rows
        append (if columns
                   (loop for j below columns collect (list array i j columns))
                   (list (list array i)))))

(defun compute (expressions variables elements)
  (list :compute (expressions-program (general-forms expressions) variables) elements))

(defun derivative-step (expressions variables count array)
  "The derivatives of EXPRESSIONS by the first COUNT of VARIABLES, but for those that are zero."
  (multiple-value-bind (program places)
      (differentiated-program (expressions-program (general-forms expressions) variables) count)
    (list :compute (tidied-program program)
          (loop for (row . column) in places collect (list array row column count)))))

(defun solved-steps (equations)
  (let ((k (length (equations-right equations))))
    (list (list :local "A" k k)
          (list :local "u" k nil)
          (compute (append (apply #'append (equations-matrix equations)) (equations-right equations))
                   (plain-variables equations)
                   (append (elements "A" k k) (elements "u" k)))
          (list :solve "A" "u" 1))))

(defun rate-routine (equations)
  (let ((n (length (equations-states equations))))
    (make-routine
     :name "rhs" :output "dydt" :rows n :what "the rates of y"
     :steps (if (equations-rates equations)
                (append (solved-steps equations)
                        (loop for rate in (equations-rates equations) for i from 0
                              collect (list :copy (list "dydt" i)
                                            (if (plusp rate) (list "y" (1- rate)) (list "u" (- -1 rate))))))
                (list (compute (equations-right equations) (plain-variables equations) (elements "dydt" n)))))))

(defun residual-forms (equations)
  "b - A u."
  (loop for row in (equations-matrix equations)
        for right in (equations-right equations)
        collect `((maxima::mplus) ,right
                  ,@(loop for entry in row for unknown in (equations-unknowns equations)
                          unless (eql entry 0) collect `((maxima::mtimes) -1 ,entry ,unknown)))))

(defun jacobian-routine (equations)
  (let ((n (length (equations-states equations))) (k (length (equations-right equations))))
    (make-routine
     :name "jacobian" :output "J" :rows n :columns n :what "the derivatives of the rates by y"
     :steps (if (equations-rates equations)
                (append (solved-steps equations)
                        (list (list :local "F" k n)
                              (list :fill "F" k n)
                              (derivative-step (residual-forms equations)
                                               (append (plain-variables equations) (equations-unknowns equations))
                                               n "F")
                              (list :solve "A" "F" n)
                              (list :fill "J" n n))
                        (loop for rate in (equations-rates equations) for i from 0
                              collect (if (plusp rate)
                                          (list :copy (list "J" i (1- rate) n) 1)
                                          (list :copy-row "J" i "F" (- -1 rate) n))))
                (list (list :fill "J" n n)
                      (derivative-step (equations-right equations) (plain-variables equations) n "J"))))))

(defun multiplier-routine (equations count)
  (make-routine
   :name "multipliers" :output "r" :rows count :what "the multipliers of the constraints"
   :steps (append (solved-steps equations)
                  (loop for i below count
                        collect (list :copy (list "r" i)
                                      (list "u" (+ i (- (length (equations-right equations)) count))))))))

(defun routines (equations)
  (let* ((mass (equations-mass equations)) (invariants (equations-invariants equations))
         (highest (count-if #'minusp (equations-rates equations)))
         (multipliers (if (equations-rates equations) (- (length (equations-right equations)) highest) 0)))
    (append (list (rate-routine equations) (jacobian-routine equations))
            (when mass
              (list (make-routine :name "mass_matrix" :output "M" :rows (length mass) :columns (length mass)
                                  :what "the second derivatives of the Lagrangian by the velocities"
                                  :steps (list (compute (apply #'append mass) (plain-variables equations)
                                                        (elements "M" (length mass) (length mass)))))))
            (when (plusp multipliers) (list (multiplier-routine equations multipliers)))
            (when invariants
              (list (make-routine :name "invariants" :output "c" :rows (length invariants)
                                  :what "what stays as it is along a motion"
                                  :steps (list (compute invariants (plain-variables equations)
                                                        (elements "c" (length invariants))))))))))

;;; Steps in a language

(defmacro of-language (language &rest texts)
  "The one of TEXTS, c form fortran form .., that belongs to LANGUAGE."
  `(ecase (intern (string-upcase (subseq (symbol-name (language-name ,language)) 1)) :keyword)
     ,@(loop for (name form) on texts by #'cddr
             collect (list (if (eq name :others) t name) form))))

(defun element-of (language element)
  (destructuring-bind (array row &optional column columns) element
    (element-text language array row column columns)))

(defun step-lines (language prefix step inputs count)
  "The lines of STEP, and how many intermediate results have a name then, if it was COUNT before."
  (if (eq :compute (first step))
      (destructuring-bind (program elements) (rest step)
        (program-statements program inputs (mapcar (lambda (element) (element-of language element)) elements)
                            language count))
      (values (list (step-line language prefix step)) count)))

(defun step-line (language prefix step)
  (flet ((f (control &rest arguments) (apply #'format nil control arguments)))
    (destructuring-bind (kind first second &optional third fourth fifth) step
      (ecase kind
        (:local
         (of-language language
                      :c (f "  double ~a[~d];" first (* second (or third 1)))
                      :fortran (f "    real(dp) :: ~a(~d~@[, ~d~])" first second third)
                      :julia (f "    ~a = zeros(eltype(y), ~d~@[, ~d~])" first second third)
                      :python (f "    ~a = np.zeros(~:[~d~;(~d, ~d)~])" first third second third)))
        (:fill
         (of-language language
                      :c (f "  for (int i = 0; i < ~d; i++) ~a[i] = 0.0;" (* second third) first)
                      :fortran (f "    ~a = 0.0d0" first)
                      :julia (f "    fill!(~a, 0)" first)
                      :python (f "    ~a[:] = 0.0" first)))
        (:solve
         (of-language language
                      :c (f "  ~a_solve(~a, ~a, ~d);" prefix first second third)
                      :fortran (f "    call solve(~a, ~a, ~d)" first second third)
                      :julia (f "    ~a .= ~a \\ ~a" second first second)
                      :python (f "    ~a = np.linalg.solve(~a, ~a)" second first second)))
        (:copy
         (f (language-assignment language) (element-of language first)
            (if (eql second 1) (foreign-number 1 language) (element-of language second))))
        (:copy-row
         (let ((base (language-base language)))
           (of-language language
                        :c (f "  for (int j = 0; j < ~d; j++) ~a[~d + j] = ~a[~d + j];"
                              fifth first (* second fifth) third (* fourth fifth))
                        :fortran (f "    ~a(~d, :) = ~a(~d, :)" first (+ base second) third (+ base fourth))
                        :julia (f "    ~a[~d, :] = ~a[~d, :]" first (+ base second) third (+ base fourth))
                        :python (f "    ~a[~d] = ~a[~d]" first second third fourth))))))))

(defun body-lines (language prefix routine inputs)
  "Declarations of places, other lines, and how many intermediate results there are."
  (let ((count 0) (locals '()) (lines '()))
    (dolist (step (routine-steps routine))
      (multiple-value-bind (new after) (step-lines language prefix step inputs count)
        (setq count after)
        (if (eq :local (first step)) (setq locals (append locals new)) (setq lines (append lines new)))))
    (values locals lines count)))

;;; Files

(defun signature (language prefix routine)
  (let ((name (routine-name routine)) (output (routine-output routine)))
    (of-language language
                 :c (format nil "void ~a_~a(double t, const double *y, const ~a_parameters *p, double *~a)"
                            prefix name prefix output)
                 :fortran (format nil "subroutine ~a(t, y, p, ~a)" name output)
                 :julia (format nil "function ~a!(~a, y, p, t)" name output)
                 :python (format nil "def ~a(t, y, p):" name))))

(defun calls (language prefix routines)
  "How each of ROUTINES is called, for people."
  (loop for routine in routines
        for size = (format nil "~d~@[ by ~d~]" (routine-rows routine) (routine-columns routine))
        append (list (format nil "  ~a" (string-right-trim ":" (signature language prefix routine)))
                     (format nil "      ~a, ~a: ~a~a" (routine-output routine) size (routine-what routine)
                             (of-language language
                                          :c (if (routine-columns routine) "; row after row" "")
                                          :fortran "" :julia "" :python "")))))

(defun c-routine (language prefix routine inputs linkage)
  (multiple-value-bind (locals lines) (body-lines language prefix routine inputs)
    (append (list "" (format nil "~a~a" linkage (signature language prefix routine)) "{")
            (loop for argument in '("t" "y" "p")
                  unless (some (lambda (line) (mentions-p line argument)) lines)
                    collect (format nil "  (void)~a;" argument))
            locals lines (list "}"))))

(defun mentions-p (line name)
  "Whether the name of one letter stands alone in LINE."
  (flet ((part-p (place) (and (< -1 place (length line))
                              (or (alphanumericp (char line place)) (char= #\_ (char line place))))))
    (loop for place = (search name line) then (search name line :start2 (1+ place))
          while place
          thereis (not (or (part-p (1- place)) (part-p (1+ place)))))))

(defun fortran-routine (language prefix routine inputs n)
  (multiple-value-bind (locals lines count) (body-lines language prefix routine inputs)
    (append (list "" (format nil "  ~a" (signature language prefix routine))
                  (format nil "    real(dp), intent(in) :: t, y(~d)" n)
                  "    type(parameters), intent(in) :: p"
                  (format nil "    real(dp), intent(out) :: ~a(~d~@[, ~d~])" (routine-output routine)
                          (routine-rows routine) (routine-columns routine)))
            locals
            (and (plusp count) (list (format nil "    real(dp) :: s(~d)" count)))
            lines
            (list (format nil "  end subroutine ~a" (routine-name routine))))))

(defun julia-routine (language prefix routine inputs)
  (multiple-value-bind (locals lines) (body-lines language prefix routine inputs)
    (append (list "" (signature language prefix routine)) locals lines
            (list (format nil "    return ~a" (routine-output routine)) "end"))))

(defun python-routine (language prefix routine inputs)
  (multiple-value-bind (locals lines) (body-lines language prefix routine inputs)
    (append (list "" "" (signature language prefix routine)
                  (format nil "    ~a = np.zeros(~:[~d~;(~d, ~d)~])" (routine-output routine)
                          (routine-columns routine) (routine-rows routine) (routine-columns routine)))
            locals lines
            (list (format nil "    return ~a" (routine-output routine))))))

(defun texts-of-inputs (language fields equations)
  (append (loop for i below (length (equations-states equations)) collect (element-text language "y" i))
          (list "t")
          (mapcar (lambda (field) (format nil (language-field language) field)) fields)
          (loop for i below (length (equations-unknowns equations)) collect (element-text language "u" i))))

(defun code-lines (language prefix header-only fields equations)
  (let* ((all (routines equations)) (inputs (texts-of-inputs language fields equations))
         (size (and (equations-rates equations) (length (equations-right equations))))
         (n (length (equations-states equations))))
    (of-language language
      :c (let ((linkage (if header-only "static inline " "")))
           (append (and header-only '("#pragma once"))
                   (list "#include <math.h>" "" "typedef struct {")
                   (or (mapcar (lambda (field) (format nil "  double ~a;" field)) fields) '("  char none;"))
                   (list (format nil "} ~a_parameters;" prefix))
                   (with-helpers (mapcan (lambda (routine) (c-routine language prefix routine inputs linkage)) all)
                                 (c-sign prefix)
                                 (and size (c-solver prefix size)))))
      :fortran (append (list (format nil "module ~a" prefix) "  implicit none"
                             "  integer, parameter :: dp = kind(1.0d0)" "  type :: parameters")
                       (mapcar (lambda (field) (format nil "    real(dp) :: ~a" field)) fields)
                       (list "  end type parameters" "contains")
                       (with-helpers (mapcan (lambda (routine) (fortran-routine language prefix routine inputs n)) all)
                                     (fortran-sign) (and size (fortran-solver size)))
                       (list (format nil "end module ~a" prefix)))
      :julia (append (list (format nil "module ~a" prefix) "" "Base.@kwdef struct Parameters")
                     (mapcar (lambda (field) (format nil "    ~a::Float64" field)) fields)
                     (list "end")
                     (mapcan (lambda (routine) (julia-routine language prefix routine inputs)) all)
                     (list "" "end"))
      :python (let ((body (mapcan (lambda (routine) (python-routine language prefix routine inputs)) all)))
                (append (and (some (lambda (line) (search "math." line)) body) (list "import math"))
                        (list "from dataclasses import dataclass" "" "import numpy as np" "" "" "@dataclass"
                              "class Parameters:")
                        (or (mapcar (lambda (field) (format nil "    ~a: float" field)) fields) '("    pass"))
                        body)))))

(defun with-helpers (lines sign solver)
  "LINES behind the helpers that they call."
  (append solver
          (and (some (lambda (line) (search "sign_of(" line)) lines) sign)
          lines))

(defun c-sign (prefix)
  (list "" (format nil "static double ~a_sign_of(double x) { return (double)((x > 0.0) - (x < 0.0)); }" prefix)))

(defun c-solver (prefix size)
  (append (list "" "/* A x = X for each of the columns of X, which becomes x: elimination with exchange of rows. */"
                (format nil "static void ~a_solve(const double *A, double *X, int columns)" prefix) "{"
                (format nil "  enum { k = ~d };" size))
          (list "  double a[k * k];"
                "  for (int i = 0; i < k * k; i++) a[i] = A[i];"
                "  for (int j = 0; j < k; j++) {"
                "    int best = j;"
                "    for (int i = j + 1; i < k; i++)"
                "      if (fabs(a[k * i + j]) > fabs(a[k * best + j])) best = i;"
                "    for (int c = 0; c < k && best != j; c++) {"
                "      const double x = a[k * j + c];"
                "      a[k * j + c] = a[k * best + c];"
                "      a[k * best + c] = x;"
                "    }"
                "    for (int c = 0; c < columns && best != j; c++) {"
                "      const double x = X[columns * j + c];"
                "      X[columns * j + c] = X[columns * best + c];"
                "      X[columns * best + c] = x;"
                "    }"
                "    for (int i = j + 1; i < k; i++) {"
                "      const double f = a[k * i + j] / a[k * j + j];"
                "      for (int c = j + 1; c < k; c++) a[k * i + c] -= f * a[k * j + c];"
                "      for (int c = 0; c < columns; c++) X[columns * i + c] -= f * X[columns * j + c];"
                "    }"
                "  }"
                "  for (int j = k - 1; j >= 0; j--)"
                "    for (int c = 0; c < columns; c++) {"
                "      double x = X[columns * j + c];"
                "      for (int i = j + 1; i < k; i++) x -= a[k * j + i] * X[columns * i + c];"
                "      X[columns * j + c] = x / a[k * j + j];"
                "    }"
                "}")))

(defun fortran-solver (size)
  (append (list "" "  ! A x = X for each of the columns of X, which becomes x: elimination with exchange of rows."
                "  subroutine solve(A, X, columns)"
                (format nil "    integer, parameter :: k = ~d" size))
          (list "    integer, intent(in) :: columns"
                "    real(dp), intent(in) :: A(k, k)"
                "    real(dp), intent(inout) :: X(k, columns)"
                "    real(dp) :: B(k, k), row(k), other(columns), f"
                "    integer :: i, j, best"
                "    B = A"
                "    do j = 1, k"
                "      best = j - 1 + maxloc(abs(B(j:k, j)), 1)"
                "      row = B(j, :)"
                "      B(j, :) = B(best, :)"
                "      B(best, :) = row"
                "      other = X(j, :)"
                "      X(j, :) = X(best, :)"
                "      X(best, :) = other"
                "      do i = j + 1, k"
                "        f = B(i, j) / B(j, j)"
                "        B(i, j+1:k) = B(i, j+1:k) - f * B(j, j+1:k)"
                "        X(i, :) = X(i, :) - f * X(j, :)"
                "      end do"
                "    end do"
                "    do j = k, 1, -1"
                "      do i = j + 1, k"
                "        X(j, :) = X(j, :) - B(j, i) * X(i, :)"
                "      end do"
                "      X(j, :) = X(j, :) / B(j, j)"
                "    end do"
                "  end subroutine solve")))

(defun fortran-sign ()
  (list "" "  elemental real(dp) function sign_of(x)"
        "    real(dp), intent(in) :: x"
        "    sign_of = 0.0d0"
        "    if (x > 0.0d0) sign_of = 1.0d0"
        "    if (x < 0.0d0) sign_of = -1.0d0"
        "  end function sign_of"))

;;; The whole file

(defun field-lines (language fields names)
  "Parameters and what they are called in the code."
  (loop for field in fields for name in names
        collect (format nil "  ~a~:[   ~a~;~]" (format nil (language-field language) field)
                        (string= field name) name)))

(defun state-lines (language array names)
  (loop for name in names for i from 0
        append (lines-in (broken-text (format nil "  ~a   ~a" (element-text language array i) name) 10))))

(defun usage-lines (language prefix n)
  (of-language language
    :c (list (format nil "Compile it, or include it; ~a_parameters has the parameters by name." prefix))
    :fortran (list (format nil "use ~a; the parameters are type(parameters)." prefix))
    :julia (list (format nil "include this file; p = ~a.Parameters(..), by name; with OrdinaryDiffEq:" prefix)
                 (format nil "  ODEProblem(~a.rhs!, y0, (t0, t1), p), y0 a vector of ~d" prefix n))
    :python (list (format nil "p = Parameters(..), by name; with SciPy:")
                  "  scipy.integrate.solve_ivp(rhs, [t0, t1], y0, args=(p,), jac=jacobian)"
                  "  (jac for its implicit methods alone)")))

(defun code-file (language prefix header-only title equations names invariant-names)
  "All lines.  TITLE is a list of lines, NAMES lists of texts: of the states and of the parameters."
  (destructuring-bind (states parameters) names
    (let ((fields (identifiers parameters language)))
      (append (comment-lines
               (append title (list "" "The state y:") (state-lines language "y" states)
                       (list "" (if fields "The parameters p:" "There are no parameters."))
                       (field-lines language fields parameters)
                       (and invariant-names (list* "" "What stays as it is, in exact arithmetic:"
                                                   (state-lines language "c" invariant-names)))
                       (list "" "Calls, t the time:") (calls language prefix (routines equations))
                       (list "") (usage-lines language prefix (length states)))
               language)
              (code-lines language prefix header-only fields equations)))))

(defun c-p (language)
  (eq 'maxima::$c (language-name language)))

(defun prefix-of (language text)
  "The name TEXT of a module, which none of what stands or is called in it may have; in C it only begins names."
  (first (identifiers (list text) language
                      (append '("t" "y" "p" "s" "u" "a" "f" "j" "m" "r" "c" "x" "dp" "parameters" "rhs" "jacobian"
                                "solve" "mass_matrix" "invariants" "multipliers" "sign_of" "dydt" "np" "math" "module"
                                "main")
                              (unless (c-p language) (names-called language))))))

(defun language-of-file (language prefix)
  (if (c-p language) (with-prefixed-sign language prefix) language))

(maxima::defmfun maxima::$anmech_check_language (language file)
  "anmech_check_language(name, file): complains unless code of this language goes into such a file."
  (let ((found (language-named language)))
    (unless (member (suffix-of file) (language-suffixes found) :test #'string-equal)
      (complain "the name of a file for ~a ends with ~{.~a~^ or ~}, found ~a" (plain-name (language-name found))
                (language-suffixes found) (one-line file)))))

(maxima::defmfun maxima::$anmech_code_file (language file name title names states time parameters unknowns rates matrix
                                            right mass invariants)
  "anmech_code_file(language, file, name or false, title lines, [names of states, of parameters, of invariants], states,
time, parameters, unknowns, rates, A, b, mass, invariants): the lines of the file; see the structure equations."
  (let* ((plain (language-named language)) (prefix (prefix-of plain (or name (stem-of file))))
         (language (language-of-file plain prefix)))
    (flet ((rows (matrix) (and matrix (mapcar #'rest (rest matrix))))
           (texts (list) (mapcar (lambda (text) (coerce text 'string)) (rest list))))
      (let ((lists (mapcar #'texts (rest names))))
        (with-compilation-errors
          (lambda (&aux (*roots-of-powers* nil))
            (maxima-list
             (mapcar (lambda (line) (coerce line 'simple-string))
                     (code-file language prefix (string-equal (suffix-of file) "h") (texts title)
                                (make-equations :states (rest states) :time time :parameters (rest parameters)
                                                :unknowns (rest unknowns) :rates (and rates (rest rates))
                                                :matrix (rows matrix) :right (rest right) :mass (rows mass)
                                                :invariants (rest invariants))
                                (subseq lists 0 2) (third lists))))))))))
